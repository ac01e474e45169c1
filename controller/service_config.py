"""The service's own configuration: where its socket, its memory and its figures are."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from controller.config_section import Section


class ServiceConfig(Section):
    """What `portdock run` offers to the machine it runs on."""

    socket: str | None = None
    """UNIX socket for `portdock dock` and the like. None: `portdock.sock` in the runtime folder (`/run/portdock` under
    systemd, else `$XDG_RUNTIME_DIR/portdock`, else `/tmp/portdock-UID`)."""
    state_folder: str | None = None
    """What must survive a restart: the axis of an insertion, the lock. None: `$STATE_DIRECTORY` under systemd, else
    `~/.local/state/portdock`."""
    http_port: Annotated[int, Field(ge=0, le=65535)] = 9464
    """Loopback port of /metrics and /health. 0: neither."""
