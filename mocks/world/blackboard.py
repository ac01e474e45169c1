"""The state that the mock processes share: a memory-mapped file ``blackboard`` in the run's folder.

The arm mock publishes where the flange and the plug are, the charger mock whether the plug is locked and whether the
E-stop is pressed, the scanner mock how many sweeps it has started, whoever runs the world where the next car has
parked; each reads the others' sections. It stands for what real devices share by being in one place, and for one
clock, so nothing in it travels over a wire.

Each section is a short ring of records with one writer. A record carries its sequence number and a CRC: a reader
takes the newest record whose CRC fits, so it never sees a half-written value, even when the writer was killed.
"""

from __future__ import annotations

import mmap
import struct
import time
import zlib
from collections.abc import Callable
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from perception.geometry import Array

FILE_NAME = "blackboard"
_MAGIC = b"PDWORLD1"
_HEADER = struct.Struct("<8sdd")
_HEADER_BYTES = 64
_SEQUENCE = struct.Struct("<Q")
_CRC = struct.Struct("<I")


@dataclass(frozen=True, slots=True)
class PlugState:
    """How the plug sits in the port. Depth is below the rim plane: negative while the plug is outside."""

    depth_m: float
    lateral_m: float
    """Distance of the plug's axis from the port's."""
    roll_rad: float
    tilt_rad: float
    seated: bool
    """Within half a millimetre of fully mated."""
    force_n: float
    """Magnitude of the contact force."""

    @staticmethod
    def away() -> PlugState:
        """The plug is nowhere near the port."""
        return PlugState(depth_m=-1.0, lateral_m=0.0, roll_rad=0.0, tilt_rad=0.0, seated=False, force_n=0.0)


class _Section:
    """A ring of records in the file: one writer, any number of readers."""

    def __init__(self, memory: mmap.mmap, offset: int, layout: str, slots: int) -> None:
        self._memory = memory
        self._offset = offset
        self._payload = struct.Struct(layout)
        self._size = -(-(_SEQUENCE.size + self._payload.size + _CRC.size) // 8) * 8
        self._slots = slots
        self.end = offset + _SEQUENCE.size + self._size * slots

    def put(self, *values: float) -> None:
        """Append one record; the sequence number in front of the ring moves last."""
        sequence = self.newest() + 1
        body = _SEQUENCE.pack(sequence) + self._payload.pack(*values)
        start = self._start(sequence)
        self._memory[start : start + len(body) + _CRC.size] = body + _CRC.pack(zlib.crc32(body))
        self._memory[self._offset : self._offset + _SEQUENCE.size] = _SEQUENCE.pack(sequence)

    def newest(self) -> int:
        """Sequence number of the last complete record; 0 before the first."""
        number: int = _SEQUENCE.unpack_from(self._memory, self._offset)[0]
        return number

    def at(self, sequence: int) -> tuple[float, ...] | None:
        """The record with this number, or None if it was overwritten or is being written."""
        start = self._start(sequence)
        raw = self._memory[start : start + _SEQUENCE.size + self._payload.size + _CRC.size]
        body = raw[: -_CRC.size]
        if _CRC.unpack(raw[-_CRC.size :])[0] != zlib.crc32(body) or _SEQUENCE.unpack_from(body)[0] != sequence:
            return None
        return self._payload.unpack_from(body, _SEQUENCE.size)

    def last(self) -> tuple[float, ...] | None:
        """The newest record, or None before the first."""
        for _ in range(1000):  # each miss means that the writer has moved on meanwhile
            sequence = self.newest()
            if sequence == 0:
                return None
            record = self.at(sequence)
            if record is not None:
                return record
        raise RuntimeError("the blackboard file is damaged")

    def oldest(self) -> int:
        """A sequence number that is still safe to read while the writer goes on."""
        return max(1, self.newest() - self._slots + 1 + self._slots // 16)

    def _start(self, sequence: int) -> int:
        return self._offset + _SEQUENCE.size + self._size * (sequence % self._slots)


class Blackboard:
    """What the mocks of one run share. Make it once with ``create``; each mock process calls ``attach``."""

    def __init__(self, path: Path, clock_s: Callable[[], float]) -> None:
        self._clock_s = clock_s
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        header: tuple[bytes, float, float] = _HEADER.unpack_from(self._memory, 0)
        magic, self._t0_s, self.time_scale = header
        if magic != _MAGIC:
            raise ValueError(f"{path} is not a blackboard")
        self._arm = _Section(self._memory, _HEADER_BYTES, _ARM_LAYOUT, _ARM_SLOTS)
        self._plug = _Section(self._memory, self._arm.end, "<6d", _SLOTS)
        self._lock = _Section(self._memory, self._plug.end, "<d", _SLOTS)
        self._estop = _Section(self._memory, self._lock.end, "<d", _SLOTS)
        self._sweep = _Section(self._memory, self._estop.end, "<d", _SLOTS)
        self._edge = _Section(self._memory, self._sweep.end, "<dd", _EDGE_SLOTS)
        self._car = _Section(self._memory, self._edge.end, "<6d", _SLOTS)

    @staticmethod
    def create(folder: Path, time_scale: float = 1.0, clock_s: Callable[[], float] = time.monotonic) -> Blackboard:
        """Make the file; world time starts now and runs ``time_scale`` times as fast as the wall clock."""
        if not 0.0 < time_scale < 1e6:
            raise ValueError("time_scale is a positive factor")
        path = folder / FILE_NAME
        partial = path.with_suffix(".partial")
        header = _HEADER.pack(_MAGIC, clock_s(), time_scale)
        partial.write_bytes(header + bytes(_FILE_BYTES - len(header)))
        partial.replace(path)
        return Blackboard(path, clock_s)

    @staticmethod
    def attach(folder: Path, clock_s: Callable[[], float] = time.monotonic) -> Blackboard:
        """Open what ``create`` made. Raises FileNotFoundError."""
        return Blackboard(folder / FILE_NAME, clock_s)

    def close(self) -> None:
        """Unmap the file."""
        self._memory.close()

    def world_time_s(self) -> float:
        """Emulated seconds since creation, the same in every process."""
        return (self._clock_s() - self._t0_s) * self.time_scale

    # --- arm: written by the arm mock ---------------------------------------------------------------------------

    def put_arm(self, time_s: float, T_base_flange: Array) -> None:
        """Publish the flange's pose (4, 4) at a world time later than the last one."""
        self._arm.put(time_s, *T_base_flange[:3].ravel())

    def latest_arm(self) -> tuple[float, Array] | None:
        """World time and pose (4, 4) of the newest sample."""
        record = self._arm.last()
        return None if record is None else (record[0], _matrix(record))

    def arm_pose_at(self, time_s: float) -> Array | None:
        """Flange pose (4, 4) at a world time, linear and slerp between samples; None if not yet or no longer known."""
        low, high = self._arm.oldest(), self._arm.newest()
        first, last = self._arm_record(low), self._arm_record(high)
        if first is None or last is None or not first[0] <= time_s <= last[0]:
            return None
        while high - low > 1:
            middle = (low + high) // 2
            record = self._arm_record(middle)
            if record is None:
                return None
            if record[0] <= time_s:
                low, first = middle, record
            else:
                high, last = middle, record
        return _between(first, last, time_s)

    def _arm_record(self, sequence: int) -> tuple[float, ...] | None:
        return self._arm.at(sequence) if sequence > 0 else None

    # --- rising edges of the arm's digital outputs: written by the arm mock ---------------------------------------

    def put_edge(self, time_s: float, output: int) -> None:
        """A digital output rose at a world time."""
        self._edge.put(time_s, float(output))

    def edges(self, after: int) -> list[tuple[int, float, int]]:
        """(number, world time, output) of the edges with a greater number than ``after``, as far as they are kept."""
        found = []
        for number in range(max(after + 1, self._edge.oldest()), self._edge.newest() + 1):
            record = self._edge.at(number)
            if record is not None:
                found.append((number, record[0], int(record[1])))
        return found

    # --- plug: written by the arm mock --------------------------------------------------------------------------

    def put_plug(self, plug: PlugState) -> None:
        """Publish how the plug sits in the port."""
        self._plug.put(*astuple(plug))

    def plug(self) -> PlugState:
        """How the plug sits in the port; ``PlugState.away()`` before the arm mock has spoken."""
        record = self._plug.last()
        if record is None:
            return PlugState.away()
        depth, lateral, roll, tilt, seated, force = record
        return PlugState(depth, lateral, roll, tilt, bool(seated), force)

    # --- lock and E-stop: written by the charger mock; sweeps: written by the scanner mock ------------------------

    def put_lock(self, locked: bool) -> None:
        """Publish whether the latch holds the plug."""
        self._lock.put(float(locked))

    def lock(self) -> bool:
        """Whether the latch holds the plug."""
        return bool((self._lock.last() or (0.0,))[0])

    def put_estop(self, pressed: bool) -> None:
        """Publish whether the E-stop is pressed."""
        self._estop.put(float(pressed))

    def estop(self) -> bool:
        """Whether the E-stop is pressed."""
        return bool((self._estop.last() or (0.0,))[0])

    def put_sweep(self, count: int) -> None:
        """Publish how many sweeps the scanner has started."""
        self._sweep.put(float(count))

    def sweep(self) -> int:
        """How many sweeps the scanner has started."""
        return int((self._sweep.last() or (0.0,))[0])

    # --- car: written by whoever runs the world ------------------------------------------------------------------

    def put_car(self, T_base_port: tuple[float, ...]) -> None:
        """Another car has parked: its port's pose as a vector (6,), metres and rotation vector in radians."""
        self._car.put(*T_base_port)

    def cars(self) -> int:
        """How many have come since the world began; 0: the one of ``world.json`` stands there."""
        return self._car.newest()

    def car(self) -> tuple[float, ...] | None:
        """Where the last one's port is, as ``put_car`` was told; None while the first car stands there."""
        return self._car.last()


_ARM_LAYOUT = "<13d"
_ARM_SLOTS = 16384  # half a minute at 500 Hz
_SLOTS = 16
_EDGE_SLOTS = 256
_FILE_BYTES = 1 << 21


def _matrix(record: tuple[float, ...]) -> Array:
    matrix = np.eye(4)
    matrix[:3] = np.reshape(record[1:], (3, 4))
    return matrix


def _between(before: tuple[float, ...], after: tuple[float, ...], time_s: float) -> Array:
    """Linear in translation, slerp in rotation."""
    if time_s <= before[0] or after[0] <= before[0]:
        return _matrix(before)
    share = (time_s - before[0]) / (after[0] - before[0])
    start, end = _matrix(before), _matrix(after)
    matrix = (1.0 - share) * start + share * end
    turn = Rotation.from_matrix(start[:3, :3].T @ end[:3, :3]).as_rotvec()
    matrix[:3, :3] = start[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
    return matrix
