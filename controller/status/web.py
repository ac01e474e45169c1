"""``/metrics`` for Prometheus and ``/health`` for a monitor, on the loopback interface only; they tell, never change.

The text format is a page of its specification, and the standard library serves it: no further dependency.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable, Iterable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from controller.states import State
from controller.status.board import Status

log = logging.getLogger(__name__)

LOOPBACK = "127.0.0.1"
TEXT = "text/plain; version=0.0.4; charset=utf-8"

Labels = tuple[tuple[str, str], ...]


class StatusWeb:
    """The web server, from its making to ``close``. A port that is taken costs the figures, not the daemon."""

    def __init__(self, port: int, status: Callable[[], Status]) -> None:
        """``port`` 0: no server."""
        self._server: ThreadingHTTPServer | None = None
        if port == 0:
            return
        try:
            self._server = ThreadingHTTPServer((LOOPBACK, port), _handler(status))
        except OSError as error:
            log.error("no metrics on port %d: %s", port, error.strerror)
            return
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, name="status-web", daemon=True).start()

    def close(self) -> None:
        """Idempotent."""
        server, self._server = self._server, None
        if server is not None:
            server.shutdown()
            server.server_close()


def _handler(status: Callable[[], Status]) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        timeout = 5.0

        def do_GET(self) -> None:
            match self.path.split("?")[0]:
                case "/metrics":
                    self._reply(200, TEXT, as_prometheus(status()))
                case "/health":
                    now = status()
                    self._reply(200 if now.healthy else 503, "application/json", json.dumps(now.to_json()) + "\n")
                case _:
                    self._reply(404, TEXT, "there are /metrics and /health\n")

        def _reply(self, code: int, kind: str, text: str) -> None:
            body = text.encode()
            self.send_response(code)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            log.debug(format, *args)

    return Handler


def as_prometheus(status: Status) -> str:
    """Prometheus' text format. Names end in their unit; counters in ``_total``."""
    return "".join(_families(status))


def _families(s: Status) -> Iterable[str]:
    yield _family("portdock_up_seconds", "gauge", "Since the daemon started.", [((), s.up_s)])
    states = [((("state", state.name),), float(state.name == s.state)) for state in State]
    yield _family("portdock_state", "gauge", "1 for the state that the controller is in.", states)
    yield _family("portdock_state_seconds", "gauge", "Since the state was entered.", [((), s.in_state_s)])
    yield _family("portdock_fault_latched", "gauge", "1 while a fault waits for a reset.", [((), float(bool(s.fault)))])
    yield _family("portdock_ticks_total", "counter", "Ticks of the supervisor.", [((), float(s.ticks))])
    outcomes = [((("outcome", kind),), float(count)) for kind, count in s.outcomes]
    yield _family("portdock_missions_total", "counter", "Missions by outcome.", outcomes)
    faults = [((("fault", code),), float(count)) for code, count in s.faults]
    yield _family("portdock_faults_total", "counter", "Faults by code.", faults)
    links = [((("link", link.name),), float(link.up)) for link in s.links]
    yield _family("portdock_link_up", "gauge", "1 while the link is up.", links)
    silent = [((("link", link.name),), link.silent_s) for link in s.links if link.silent_s is not None]
    yield _family("portdock_link_silent_seconds", "gauge", "Since the last good data of a link.", silent)
    counters = [((("link", link.name), ("what", n)), float(v)) for link in s.links for n, v in link.counters]
    yield _family("portdock_link_events_total", "counter", "What each link has counted.", counters)
    if s.current_a is not None:
        yield _family("portdock_charge_current_amperes", "gauge", "As the charger measures it.", [((), s.current_a)])
    if s.contactor_closed is not None:
        closed = float(s.contactor_closed)
        yield _family("portdock_contactor_closed", "gauge", "1 while the contactor is closed.", [((), closed)])


def _family(name: str, kind: str, text: str, samples: Iterable[tuple[Labels, float]]) -> str:
    lines = [f"{name}{_labels(labels)} {value:.10g}\n" for labels, value in samples]
    return f"# HELP {name} {text}\n# TYPE {name} {kind}\n" + "".join(lines)


def _labels(labels: Labels) -> str:
    if not labels:
        return ""
    pairs = ",".join(f'{name}="{_escaped(value)}"' for name, value in labels)
    return "{" + pairs + "}"


def _escaped(value: str) -> str:
    return value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
