"""The mock charger as a whole: node, bus, supervision of the robot and faults, driven by one ``turn`` after another."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocks.charger.controls import Lines
from mocks.charger.frames import BusFrame, Frames
from mocks.charger.node import ChargerNode
from mocks.charger.ports import BusPort, SlcanPort
from mocks.charger.process import NodeSettings
from mocks.charger.supervision import RobotWatch
from mocks.charger.world import Surroundings

COMMANDS = {
    0: "None",
    1: "Reserve",
    2: "UnlockDock",
    3: "LockPlug",
    4: "EnablePower",
    5: "StopPower",
    6: "UnlockPlug",
    7: "Release",
    8: "ResetFault",
    15: "Abort",
}


class MockCharger:
    """Everything but the loop. Cycles and the robot's time-out in wall seconds, the process in emulated ones."""

    def __init__(
        self,
        frames: Frames,
        ports: list[BusPort],
        world: Surroundings,
        rng: np.random.Generator,
        settings: NodeSettings | None = None,
        lost_s: float = 0.25,
    ) -> None:
        self._frames, self._ports, self._world, self._rng = frames, ports, world, rng
        self._settings = settings or NodeSettings()
        self._lost_s = lost_s
        self.lines = Lines()
        self.node = ChargerNode(self._settings)
        self._watch = RobotWatch(lost_s, frames.modulus if frames.counted else None)
        self._due_s = {"CH_Status": 0.0, "CH_Electrical": 0.0}
        self._last: dict[str, BusFrame] = {}
        self._twin_frames = frames.twin()

    def turn(self, wall_s: float) -> float:
        """Take what came in, move on, send what is due. Returns the wall time of the next due frame."""
        for port in self._ports:
            for frame in port.receive():
                self._forward(frame, port)
                self._hear(frame, wall_s)
        self.node.step(self._world.now_s(), self._world.plugged(), self._world.estop(), self._watch.view(wall_s))
        self._world.set_lock(self.node.lock.holds)
        for name in self._due_s:
            if wall_s >= self._due_s[name]:
                self._speak(name)
                self._due_s[name] = max(self._due_s[name] + self._frames.cycle_s(name), wall_s)
        return min(self._due_s.values())

    def _forward(self, frame: BusFrame, source: BusPort) -> None:
        """A bus: what one adapter sends, the others see."""
        for port in self._ports:
            if port is not source:
                port.send(frame)

    def _hear(self, frame: BusFrame, wall_s: float) -> None:
        message = None if self.lines.deaf else self._frames.decode(frame)
        if message is None:
            return
        name, values = message
        if name == "RC_Heartbeat":
            self._watch.heartbeat(int(values.get("Counter", 0)), int(values["Flags"]), wall_s)
        elif name == "RC_Command":
            self.node.step(self._world.now_s(), self._world.plugged(), self._world.estop(), self._watch.view(wall_s))
            self.node.command(COMMANDS.get(int(values["Cmd"]), "?"), int(values["CmdSeq"]), int(values["Arg"]))

    def _speak(self, name: str) -> None:
        lines = self.lines
        if lines.silent:
            return
        if not (lines.frozen and name in self._last):
            values = self.node.status() if name == "CH_Status" else self.node.electrical()
            if lines.mute and name == "CH_Status":
                values |= {"AckSeq": 0, "AckResult": "None"}
            self._last[name] = self._frames.encode(name, values, stuck=lines.stuck_counter, damaged=lines.damaged)
        frames = [self._last[name]]
        if lines.twin:
            other = ChargerNode(self._settings)
            values = other.status() if name == "CH_Status" else other.electrical()
            frames.append(self._twin_frames.encode(name, values))
        for port in self._ports:
            for frame in frames:
                port.send(frame)

    def control(self, values: dict[str, Any]) -> None:
        """Apply one control line (see ``controls``)."""
        for key, value in values.items():
            if key in Lines.__dataclass_fields__:
                setattr(self.lines, key, bool(value))
            else:
                self._pull(key, value)

    def _pull(self, lever: str, value: Any) -> None:
        node = self.node
        match lever:
            case "estop":
                self._world.set_estop(bool(value))
            case "plugged":
                self._world.set_plugged(bool(value))
            case "lock_jammed":
                node.lock.jammed = bool(value)
            case "contactor_welded":
                node.power.welded = bool(value)
            case "reject":
                node.reject_next = value
            case "paused":
                node.process.paused = bool(value)
            case "temperature_c":
                node.power.temperature_c = float(value)
            case "release_pressed":
                node.process.release_pressed = bool(value)
            case "precharge_fails":
                node.power.precharge_fails = bool(value)
            case "ventilation":
                node.process.ventilation = bool(value)
            case "reboot":
                self._reboot()
            case "garbage":
                for port in self._adapters():
                    port.write(self._rng.bytes(int(value)))
            case "unplug_adapter":
                for port in self._adapters():
                    if value:
                        port.unplug()
                    else:
                        port.plug_in()

    def _reboot(self) -> None:
        """Power off and on, every fault taken out."""
        self.lines = Lines()
        self.node = ChargerNode(self._settings)
        self._watch = RobotWatch(self._lost_s, self._frames.modulus if self._frames.counted else None)
        self._world.reset()

    def _adapters(self) -> list[SlcanPort]:
        return [port for port in self._ports if isinstance(port, SlcanPort)]
