"""Non-blocking TCP in one thread: listening sockets and connections on one selector."""

from __future__ import annotations

import contextlib
import logging
import selectors
import socket
import struct
import time
from collections.abc import Callable
from typing import Protocol

log = logging.getLogger(__name__)

STALLED_AFTER_S = 10.0
"""A client that takes no data for this long is dropped, as a real controller does."""


class Handler(Protocol):
    """What is behind one connection."""

    def received(self, data: bytes) -> None:
        """Bytes from the client, in whatever pieces."""

    def closed(self) -> None:
        """The connection has gone."""


class Connection:
    """One accepted connection."""

    def __init__(self, sock: socket.socket, selector: selectors.BaseSelector) -> None:
        self._socket = sock
        self._selector = selector
        self._out = bytearray()
        self._stalled_since: float | None = None
        self.handler: Handler | None = None
        self.open = True
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        selector.register(sock, selectors.EVENT_READ, self._ready)

    @property
    def backlog(self) -> bool:
        """Whether bytes wait to be taken by the client."""
        return bool(self._out)

    def send(self, data: bytes) -> None:
        """Queue bytes and send what goes at once."""
        if self.open:
            self._out += data
            self._flush()

    def close(self, reset: bool = False) -> None:
        """Close; with ``reset`` the client sees a reset instead of an orderly end."""
        if not self.open:
            return
        self.open = False
        self._selector.unregister(self._socket)
        if reset:
            with contextlib.suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._socket.close()
        if self.handler is not None:
            self.handler.closed()

    def _ready(self, events: int) -> None:
        if events & selectors.EVENT_WRITE:
            self._flush()
        if not self.open or not events & selectors.EVENT_READ:
            return
        try:
            data = self._socket.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.close()
        elif self.handler is not None:
            self.handler.received(data)

    def _flush(self) -> None:
        try:
            sent = self._socket.send(self._out)
        except BlockingIOError:
            sent = 0
        except OSError:
            self.close()
            return
        del self._out[:sent]
        now = time.monotonic()
        self._stalled_since = None if not self._out else self._stalled_since or now
        if self._stalled_since is not None and now - self._stalled_since > STALLED_AFTER_S:
            log.info("client does not read: dropped")
            self.close()
            return
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if self._out else 0)
        self._selector.modify(self._socket, wanted, self._ready)


class Listener:
    """One listening port and its live connections."""

    def __init__(
        self, selector: selectors.BaseSelector, host: str, port: int, make: Callable[[Connection], Handler]
    ) -> None:
        self._selector = selector
        self._host, self.port = host, port
        self._make = make
        self.connections: list[Connection] = []
        self._socket: socket.socket | None = None
        self.open()

    def open(self) -> None:
        """Listen. Raises OSError when the port is taken."""
        if self._socket is not None:
            return
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.bind((self._host, self.port))
        self._socket.listen(16)
        self._socket.setblocking(False)
        self._selector.register(self._socket, selectors.EVENT_READ, self._accept)

    def drop(self) -> None:
        """Reset every live connection."""
        for connection in self.live():
            connection.close(reset=True)

    def live(self) -> list[Connection]:
        """Open connections."""
        self.connections = [connection for connection in self.connections if connection.open]
        return self.connections

    def close(self) -> None:
        """Stop listening and cut every connection."""
        if self._socket is not None:
            self._selector.unregister(self._socket)
            self._socket.close()
            self._socket = None
        self.drop()

    def _accept(self, events: int) -> None:
        try:
            sock, _ = self._socket.accept() if self._socket else (None, None)
        except OSError:
            return
        if sock is None:
            return
        connection = Connection(sock, self._selector)
        self.connections.append(connection)
        connection.handler = self._make(connection)
