"""Bytes of a streaming scanner -> profiles. Pure: no device, no clock, no thread.

A frame counts only if sync bytes, constant fields and checksum agree. Where they do not, the parser goes on ONE byte
later: a lost byte costs the frame it was lost from, never the next one. A broken frame is dropped, never patched. Runs
of good frames are checked and decoded together, so that the parser is far faster than any line.

A checksum of eight bits lets one in 256 broken frames pass. Where the device streams without pauses, the format can
therefore ask that the next frame's sync bytes stand right behind a frame (``confirmed_by_next``): lost, added and cut
bytes do not pass that.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from drivers.frame_format import FrameFormat
from drivers.scanner.checksums import checksum_function
from drivers.scanner.counters import ClockUnwrapper, SequenceTracker
from drivers.scanner.frame_decode import Frames, decode_points
from perception.scan import Profile

MAX_RUN = 64


@dataclass
class FrameCounters:
    """What came over the line since the parser was made."""

    bytes: int = 0
    frames: int = 0
    bytes_dropped: int = 0
    bad_checksum: int = 0
    unconfirmed: int = 0
    """Frames with a good checksum that no next frame followed; only where the format asks for one."""
    lost: int = 0
    stale: int = 0

    def as_pairs(self) -> tuple[tuple[str, int], ...]:
        """(name, count) of each."""
        return tuple((item.name, getattr(self, item.name)) for item in fields(self))


@dataclass
class FrameParser:
    """One stream's state: the bytes of an unfinished frame, and the counters that run through it."""

    layout: FrameFormat
    counters: FrameCounters = field(default_factory=FrameCounters)
    acks: list[bytes] = field(default_factory=list)
    """Acknowledgements seen and not yet taken by the owner, oldest first."""

    def __post_init__(self) -> None:
        layout = self.layout
        self._rest = b""
        self._ack_tokens = tuple(c.ack for c in (layout.start, layout.stop) if c and c.ack)
        self._tokens = (layout.sync, *self._ack_tokens)
        self._sync = np.frombuffer(layout.sync, np.uint8)
        covered = layout.size - layout.checksum.width - layout.checksum.from_byte
        self._checksum = checksum_function(layout.checksum, covered)
        self._tail = len(layout.sync) if layout.confirmed_by_next else 0
        self._clock = ClockUnwrapper(layout.clock) if layout.clock else None
        self._sequence = SequenceTracker(layout.sequence) if layout.sequence else None
        self._running_number = 0

    def feed(self, data: bytes, host_time_ns: int) -> list[Profile]:
        """Profiles completed by ``data``, which was read at ``host_time_ns``. Never raises, whatever the bytes."""
        self.counters.bytes += len(data)
        buffer = self._rest + data
        position = 0
        profiles: list[Profile] = []
        while position < len(buffer):
            run = self._good_frames(buffer, position)
            ack = next((token for token in self._ack_tokens if buffer.startswith(token, position)), None)
            if len(run):
                profiles += self._profiles(run, host_time_ns * 1e-9)
                position += run.nbytes
            elif ack is not None:
                self.acks.append(ack)
                position += len(ack)
            elif self._may_continue(buffer, position):
                break
            else:
                position = self._skip(buffer, position)
        self._rest = buffer[position:]
        return profiles

    def abandon_partial(self) -> None:
        """Give up the frame that was begun: its rest is not coming. What it hid is looked at with the next bytes."""
        if self._rest:
            self.counters.bytes_dropped += 1
            self._rest = self._rest[1:]

    def restart(self) -> None:
        """A new stream of the same device begins: any sequence number may come next."""
        if self._sequence:
            self._sequence.restart()

    def _good_frames(self, buffer: bytes, position: int) -> Frames:
        """The longest run of good frames that starts here; empty where none does."""
        first = self._checked(buffer, position, 1)
        if not len(first):
            return first
        more = min(MAX_RUN, (len(buffer) - position - self._tail) // self.layout.size)
        return self._checked(buffer, position, more) if more > 1 else first

    def _checked(self, buffer: bytes, position: int, count: int) -> Frames:
        """Up to ``count`` frames from here, cut before the first that is not good."""
        size, checksum = self.layout.size, self.layout.checksum
        empty = np.empty(0, self.layout.dtype)
        end = position + count * size
        if not buffer.startswith(self.layout.sync, position) or end + self._tail > len(buffer):
            return empty
        raw: NDArray[np.uint8] = np.frombuffer(buffer, np.uint8, count * size, position).reshape(count, size)
        frames: Frames = raw.view(self.layout.dtype)[:, 0]
        synced = (raw[:, : len(self._sync)] == self._sync).all(axis=1)
        summed = np.array(synced)
        for name, value in self.layout.constants:
            summed &= frames[name] == value
        framed = bool(summed[0])
        if checksum.width:
            covered = raw[:, checksum.from_byte : size - checksum.width]
            summed &= self._checksum(covered) == frames["checksum"]
        sound = summed & np.append(synced[1:], buffer.startswith(self.layout.sync, end)) if self._tail else summed
        good = count if sound.all() else int(np.argmin(sound))
        if count == 1 and not good:
            self.counters.bad_checksum += framed and not summed[0]
            self.counters.unconfirmed += bool(summed[0])
        return frames[:good]

    def _may_continue(self, buffer: bytes, position: int) -> bool:
        """Whether what stands here may become a frame or an answer with more bytes."""
        left = len(buffer) - position
        if left < self.layout.size + self._tail and buffer.startswith(self.layout.sync, position):
            return True
        return any(left < len(token) and token.startswith(buffer[position:]) for token in self._tokens)

    def _skip(self, buffer: bytes, position: int) -> int:
        """The next position at which a frame or an answer may begin, at least one byte on."""
        starts = [buffer.find(token[:1], position + 1) for token in self._tokens]
        following = min((start for start in starts if start >= 0), default=len(buffer))
        self.counters.bytes_dropped += following - position
        return following

    def _profiles(self, frames: Frames, host_s: float) -> Iterator[Profile]:
        points, valid, intensity = decode_points(frames, self.layout)
        self.counters.frames += len(frames)
        for k, frame in enumerate(frames):
            number = self._number(frame)
            if number is None:
                continue
            device_s = self._clock.seconds(int(frame[self._clock.counter.field]), host_s) if self._clock else None
            seen = valid[k]
            light = intensity[k][seen] if intensity is not None else None
            yield Profile(number, host_s, device_s, points[k][seen], light, float(seen.mean()))

    def _number(self, frame: np.void) -> int | None:
        """The profile's number; None for a frame that is not new."""
        if self._sequence is None:
            self._running_number += 1
            return self._running_number - 1
        number = self._sequence.accept(int(frame[self._sequence.counter.field]))
        self.counters.lost, self.counters.stale = self._sequence.lost, self._sequence.stale
        return number
