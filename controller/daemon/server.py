"""The daemon's socket: any number of clients, one thread, one answer a request, one stream of events for subscribers.

A client that does not read is dropped once its backlog is full: no client can hold the daemon up. Signals arrive in
the same thread, so that no signal handler has to take a lock.
"""

from __future__ import annotations

import contextlib
import logging
import os
import selectors
import socket
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from controller.daemon.protocol import MAX_LINE, Answer, Event, Request, encode, request_of
from perception.errors import InputError, PortdockError

log = logging.getLogger(__name__)

BACKLOG_BYTES = 1_000_000
MODE = 0o660


class SocketError(PortdockError):
    """The daemon's socket cannot be made."""

    code: ClassVar[str] = "socket"
    default_remedy: ClassVar[str] = "Choose another path with service.socket, or make its folder writable."


@dataclass(slots=True)
class _Client:
    line: socket.socket
    received: bytearray = field(default_factory=bytearray)
    waiting: bytearray = field(default_factory=bytearray)
    subscribed: bool = False


class CommandServer:
    """Serves from ``start`` to ``close``. ``handle`` answers all requests but ``subscribe``; it must be quick."""

    def __init__(self, path: Path, handle: Callable[[Request], Answer], on_signal: Callable[[int], None]) -> None:
        """Listen on ``path``, which belongs to this process alone (it holds the robot's lock). Raises SocketError."""
        self._path, self._handle, self._on_signal = path, handle, on_signal
        self._clients: dict[int, _Client] = {}
        self._events: deque[bytes] = deque(maxlen=10_000)
        self._ended = False
        self._wake_read, self.wake_write = os.pipe()
        for descriptor in (self._wake_read, self.wake_write):
            os.set_blocking(descriptor, False)
        self._listener = _listening(path)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._wake_read, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._run, name="command-socket", daemon=True)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def publish(self, event: Event) -> None:
        """Hand an event to every subscriber. From any thread; never waits."""
        self._events.append(encode(event))
        self._wake()

    def close(self) -> None:
        """Send what is still waiting, then end. Idempotent."""
        if self._ended:
            return
        self._ended = True
        self._wake()
        if self._thread.is_alive():
            self._thread.join(timeout=2.0)
        self._path.unlink(missing_ok=True)
        self._listener.close()
        for descriptor in (self._wake_read, self.wake_write):
            os.close(descriptor)

    # --- the thread ---------------------------------------------------------------------------------------------------

    def _wake(self) -> None:
        with contextlib.suppress(OSError):  # full: it is awake
            os.write(self.wake_write, b"\0")

    def _run(self) -> None:
        while not self._ended:
            for key, mask in self._selector.select():
                if key.fileobj is self._listener:
                    self._accept()
                elif key.fileobj == self._wake_read:
                    self._woken()
                elif (client := self._clients.get(key.fd)) is not None:
                    self._talk_or_drop(client, mask)
            self._spread()
        self._spread()
        for client in list(self._clients.values()):
            self._drop(client)

    def _woken(self) -> None:
        """A byte 0 is an event that waits; any other is a signal's number (signal.set_wakeup_fd)."""
        with contextlib.suppress(BlockingIOError):
            for number in os.read(self._wake_read, 4096):
                if number:
                    try:
                        self._on_signal(number)
                    except Exception:  # this thread is the only one that hears signals
                        log.exception("signal %d", number)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            line, _ = self._listener.accept()
            line.setblocking(False)
            self._clients[line.fileno()] = _Client(line)
            self._selector.register(line, selectors.EVENT_READ)

    def _talk_or_drop(self, client: _Client, mask: int) -> None:
        try:
            self._talk(client, mask)
        except Exception:  # a defect costs one client its line, not all of them the daemon
            log.exception("a client's line")
            self._drop(client)

    def _talk(self, client: _Client, mask: int) -> None:
        if mask & selectors.EVENT_READ:
            try:
                data = client.line.recv(65536)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self._drop(client)
                return
            client.received += data
            self._take_lines(client)
        self._flush(client)

    def _take_lines(self, client: _Client) -> None:
        while (end := client.received.find(b"\n")) >= 0:
            line = bytes(client.received[:end])
            del client.received[: end + 1]
            if line.strip():
                client.waiting += encode(self._answered(client, line))
        if len(client.received) > MAX_LINE:
            client.waiting += encode(Answer("refused", reason="the line is too long"))
            client.received.clear()

    def _answered(self, client: _Client, line: bytes) -> Answer:
        try:
            request = request_of(line)
        except InputError as error:
            return Answer("refused", reason=error.cause)
        if request is Request.SUBSCRIBE:
            client.subscribed = True
            return Answer("accepted")
        log.info("request: %s", request.value) if request is not Request.STATUS else None
        return self._handle(request)

    def _spread(self) -> None:
        """Every event that waits, to every subscriber."""
        lines = b"".join(self._events.popleft() for _ in range(len(self._events)))
        for client in list(self._clients.values()):
            if client.subscribed:
                client.waiting += lines
            self._flush(client)

    def _flush(self, client: _Client) -> None:
        if client.line.fileno() not in self._clients:
            return
        try:
            while client.waiting:
                del client.waiting[: client.line.send(client.waiting)]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(client)
            return
        if len(client.waiting) > BACKLOG_BYTES:
            log.warning("a client that does not read is dropped")
            self._drop(client)
            return
        both = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.waiting else 0)
        self._selector.modify(client.line, both)

    def _drop(self, client: _Client) -> None:
        self._clients.pop(client.line.fileno(), None)
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(client.line)
        client.line.close()


def _listening(path: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)  # left behind by a daemon that was killed
        listener.bind(str(path))
        path.chmod(MODE)
        listener.listen(16)
    except OSError as error:
        listener.close()
        raise SocketError(f"cannot listen on {path}: {error.strerror or error}") from error
    listener.setblocking(False)
    return listener
