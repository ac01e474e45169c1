"""What the charger senses of the world: the mocks' shared blackboard, or a world of its own when it runs alone."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Protocol


class Surroundings(Protocol):
    """Emulated time, the plug in the port, the emergency stop, and where the lock's position goes."""

    def now_s(self) -> float: ...
    def plugged(self) -> bool: ...
    def set_plugged(self, plugged: bool) -> None: ...
    def estop(self) -> bool: ...
    def set_estop(self, pressed: bool) -> None: ...
    def set_lock(self, holds: bool) -> None: ...
    def reset(self) -> None: ...


class Alone:
    """No arm, no vehicle: the plug is put in by a control line."""

    def __init__(self, time_scale: float = 1.0) -> None:
        self._scale, self._start_s = time_scale, time.monotonic()
        self._plugged = self._estop = False

    def now_s(self) -> float:
        return (time.monotonic() - self._start_s) * self._scale

    def plugged(self) -> bool:
        return self._plugged

    def set_plugged(self, plugged: bool) -> None:
        self._plugged = plugged

    def estop(self) -> bool:
        return self._estop

    def set_estop(self, pressed: bool) -> None:
        self._estop = pressed

    def set_lock(self, holds: bool) -> None:
        """Nobody looks."""

    def reset(self) -> None:
        self._plugged = self._estop = False


class Shared:
    """The run's blackboard: the arm mock says where the plug is."""

    def __init__(self, folder: Path) -> None:
        from mocks.world.blackboard import Blackboard  # brings scipy: a second that a charger alone need not wait

        self._board = Blackboard.attach(folder)
        self._lock: bool | None = None

    def now_s(self) -> float:
        return self._board.world_time_s()

    def plugged(self) -> bool:
        return self._board.plug().seated

    def set_plugged(self, plugged: bool) -> None:
        raise ValueError("the arm mock says where the plug is")

    def estop(self) -> bool:
        return self._board.estop()

    def set_estop(self, pressed: bool) -> None:
        self._board.put_estop(pressed)

    def set_lock(self, holds: bool) -> None:
        if holds != self._lock:
            self._board.put_lock(holds)
            self._lock = holds

    def reset(self) -> None:
        """The world goes on without the charger."""
