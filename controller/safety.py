"""The gate: may this command be given now? Pure; limits in ``situation.py``; asked right before every driver call.

The gate reduces damage and nuisance. It is not a safety function: the emergency stop and the protective fields are
hard-wired, and the robot's and the charger's own interlocks give safety.
"""

from __future__ import annotations

import numpy as np

from controller.commands import (
    Announce,
    AskCharger,
    BackOff,
    Command,
    Comply,
    Laser,
    Motion,
    MoveJoints,
    MoveLinear,
    MoveVelocity,
    SetOutput,
    StopMotion,
    ZeroForce,
)
from controller.situation import CONTACT_DEPTH_M, LIVE_CURRENT_A, STILL_M_S, Limits, Refusal, Situation
from controller.states import IN_CONTACT, State
from drivers.base import ChargerRequest, ChargerStatus, PlugLock, Proximity, RobotMode, SafetyMode
from perception.geometry import Array, Pose


def check(command: Command, now: Situation, limits: Limits) -> Refusal | None:
    """None if the command may be given, else the reason why not."""
    match command:
        case StopMotion() | Announce():
            return None
        case AskCharger(request=request):
            return _check_request(request, now)
        case Laser(on=on):
            allowed = now.state is State.SCANNING or not on
            return None if allowed else Refusal("laser", f"laser on in {now.state.name}")
        case SetOutput(level=level):
            allowed = now.state is State.SCANNING or not level
            return None if allowed else Refusal("trigger", f"trigger in {now.state.name}")
        case ZeroForce():
            return _check_zero_force(now)
        case BackOff():
            return _check_back_off(command, now, limits)
        case MoveJoints() | MoveLinear() | MoveVelocity() | Comply():
            return _check_motion(command, now, limits)


def makes_safe(command: Command) -> bool:
    """Whether a command can only make things safer: allowed after a trip, in every state, and blindly."""
    match command:
        case StopMotion() | Announce(pose=None) | Laser(on=False):
            return True
        case AskCharger(request=request):
            return request in _ALWAYS
    return False


# --- charger requests -----------------------------------------------------------------------------------------------

_ALWAYS = frozenset({ChargerRequest.NONE, ChargerRequest.STOP_POWER, ChargerRequest.ABORT})
_ALLOWED_IN: dict[ChargerRequest, frozenset[State]] = {
    ChargerRequest.RESERVE: frozenset({State.STAGING, State.APPROACHING}),
    ChargerRequest.UNLOCK_DOCK: frozenset({State.STAGING, State.APPROACHING}),
    ChargerRequest.LOCK_PLUG: frozenset({State.VERIFYING}),
    ChargerRequest.ENABLE_POWER: frozenset({State.CHARGING}),
    ChargerRequest.UNLOCK_PLUG: frozenset({State.VERIFYING, State.RELEASING}),
    ChargerRequest.RELEASE: frozenset({State.READY, State.RETREATING, State.STAGING, State.RELEASING}),
    ChargerRequest.RESET_FAULT: frozenset({State.SELF_CHECK}),
}


def _check_request(request: ChargerRequest, now: Situation) -> Refusal | None:
    if request in _ALWAYS:
        return None
    if now.state not in _ALLOWED_IN[request]:
        return Refusal("charger-request", f"{request.name} in {now.state.name}")
    if request is ChargerRequest.ENABLE_POWER and (why := _not_mated(now)):
        return Refusal("power", why)
    if request is ChargerRequest.UNLOCK_PLUG and now.state is State.RELEASING and (why := _live(now.charger)):
        return Refusal("unlock", why)
    return None


def _not_mated(now: Situation) -> str | None:
    """Why power may not be wanted; None if arm and charger, freshly, both say that the plug is in and locked."""
    if not now.mated:
        return "the plug is not mated: depth, force plateau and proximity are all needed"
    if now.charger is None:
        return "the charger is silent: whether the plug is still in is unknown"
    if now.charger.proximity not in (Proximity.INSERTED, Proximity.LATCHED):
        return f"the proximity contact says {now.charger.proximity.name}"
    if now.charger.lock is not PlugLock.LOCKED:
        return f"the plug's lock is {now.charger.lock.name}"
    return None


def _live(charger: ChargerStatus | None) -> str | None:
    """Why the plug must be taken as live; None if current, contactor and freshness all say it is not."""
    if charger is None:
        return "the charger is silent: the contactor's state is unknown"
    if charger.contactor_closed:
        return "the contactor is closed"
    if not np.isfinite([charger.current_a, charger.electrical_time_s]).all():
        return "the current is not measured, or not fresh"
    if abs(charger.current_a) >= LIVE_CURRENT_A:
        return f"{charger.current_a:.1f} A are flowing"
    return None


# --- arm ------------------------------------------------------------------------------------------------------------

_MOTIONS_IN: dict[State, tuple[type, ...]] = {
    State.STAGING: (MoveJoints, MoveLinear),
    State.SCANNING: (MoveLinear,),
    State.APPROACHING: (MoveJoints, MoveLinear),
    State.INSERTING: (MoveVelocity, Comply),
    State.VERIFYING: (Comply,),
    State.RETREATING: (MoveLinear, Comply),
}


def _check_zero_force(now: Situation) -> Refusal | None:
    if now.state not in (State.SELF_CHECK, State.APPROACHING, State.INSERTING):
        return Refusal("zero-force", f"not in {now.state.name}")
    if now.charger is None or now.charger.proximity is not Proximity.ABSENT:
        return Refusal("zero-force", "only with no plug inserted")
    if now.arm is None or not np.linalg.norm(now.arm.tcp_speed[:3]) <= STILL_M_S:
        return Refusal("zero-force", "only with the arm at rest")
    if now.T_base_port is not None and not _depth_m(now.arm.T_base_tcp, now.T_base_port) <= CONTACT_DEPTH_M:
        return Refusal("zero-force", "only out of contact")
    return None


def _check_back_off(command: BackOff, now: Situation, limits: Limits) -> Refusal | None:
    """The one motion that is allowed while the charger is silent: before contact, straight out on the port's axis."""
    if now.state is not State.APPROACHING or now.T_base_port is None:
        return Refusal("state", f"BackOff in {now.state.name}")
    if now.arm is None or now.arm.mode is not RobotMode.RUNNING:
        return Refusal("arm", "the arm's state is not fresh, or it is not running")
    if now.arm.safety not in (SafetyMode.NORMAL, SafetyMode.REDUCED):
        return Refusal("arm", f"safety mode {now.arm.safety.name}")
    if now.charger is not None and now.charger.forbids_motion:
        return Refusal("charger", "the charger inhibits motion")
    force_n = float(np.linalg.norm(now.arm.wrench[:3]))
    if not force_n < limits.touch_force_n:
        return Refusal("contact", f"{force_n:.1f} N at the plug")
    if not 0 < command.speed_m_s <= limits.linear_speed_m_s:
        return Refusal("speed", f"{command.speed_m_s * 1000:.1f} mm/s")
    depth_m = _depth_m(now.arm.T_base_tcp, now.T_base_port)
    target_depth_m = _depth_m(command.T_base_tcp, now.T_base_port)
    if not target_depth_m < depth_m <= CONTACT_DEPTH_M:
        return Refusal("axis", "only from before the rim, and only outwards")
    lateral_m = _sideways_m(now.arm.T_base_tcp, command.T_base_tcp, now.T_base_port)
    if not lateral_m <= limits.capture_radius_m:
        return Refusal("axis", f"{lateral_m * 1000:.1f} mm sideways")
    return _check_target(command.T_base_tcp, limits)


def _check_motion(command: Motion, now: Situation, limits: Limits) -> Refusal | None:
    """Rules that hold for every motion, then the one for its kind, then those of an inserted plug."""
    if not isinstance(command, _MOTIONS_IN.get(now.state, ())):
        return Refusal("state", f"{type(command).__name__} in {now.state.name}")
    if now.arm is None:
        return Refusal("arm", "the arm's state is not fresh")
    if now.arm.mode is not RobotMode.RUNNING:
        return Refusal("arm", f"robot mode {now.arm.mode.name}")
    if now.arm.safety not in (SafetyMode.NORMAL, SafetyMode.REDUCED):
        return Refusal("arm", f"safety mode {now.arm.safety.name}")
    if now.charger is None:
        return Refusal("charger", "the charger's status is not fresh")
    if now.charger.forbids_motion:
        return Refusal("charger", "the charger inhibits motion")
    refusal = _check_bounds(command, now, limits)
    return refusal or _check_inserted(command, now, limits)


def _check_bounds(command: Motion, now: Situation, limits: Limits) -> Refusal | None:
    match command:
        case MoveJoints(T_base_tcp=target, speed_rad_s=speed):
            if not 0 < speed <= limits.joint_speed_rad_s:
                return Refusal("speed", f"{np.rad2deg(speed):.1f} deg/s")
            return _check_target(target, limits)
        case MoveLinear(T_base_tcp=target, speed_m_s=speed):
            fastest = limits.withdraw_speed_m_s if plug_inserted(now) else limits.linear_speed_m_s
            if not 0 < speed <= fastest:
                return Refusal("speed", f"{speed * 1000:.1f} mm/s, at most {fastest * 1000:.1f}")
            return _check_target(target, limits)
        case MoveVelocity(velocity=velocity):
            return _check_velocity(velocity, limits)
        case Comply(compliance=c):
            return _check_compliance(np.array(c.wrench), np.array(c.selection), np.array(c.limits), now.state, limits)


def _check_target(target: Pose, limits: Limits) -> Refusal | None:
    position = target.translation
    if not (np.isfinite(position).all() and np.isfinite(target.rotation).all()):
        return Refusal("target", "not finite")
    if (position < limits.workspace_min_m).any() or (position > limits.workspace_max_m).any():
        return Refusal("workspace", f"target {np.round(position * 1000).astype(int).tolist()} mm is outside")
    return None


def _check_velocity(velocity: Array, limits: Limits) -> Refusal | None:
    if velocity.shape != (6,) or not np.isfinite(velocity).all():
        return Refusal("speed", "a velocity is six finite numbers")
    if np.linalg.norm(velocity[:3]) > limits.insertion_speed_m_s * 1.001:
        return Refusal("speed", f"{np.linalg.norm(velocity[:3]) * 1000:.1f} mm/s")
    if np.linalg.norm(velocity[3:]) > limits.insertion_turn_rad_s * 1.001:
        return Refusal("speed", f"{np.rad2deg(np.linalg.norm(velocity[3:])):.1f} deg/s")
    return None


def _check_compliance(wrench: Array, selection: Array, bounds: Array, state: State, limits: Limits) -> Refusal | None:
    """Force mode in the port's frame: axial force, lateral force, moment, speeds of the compliant axes."""
    if not (np.isfinite(wrench).all() and np.isfinite(bounds).all() and (bounds > 0).all()):
        return Refusal("force", "wrench and limits must be finite, limits positive")
    if abs(wrench[2]) > limits.axial_force_n or np.linalg.norm(wrench[:2]) > limits.lateral_force_n:
        return Refusal("force", f"{np.round(wrench[:3], 1).tolist()} N is over the cap")
    if np.linalg.norm(wrench[3:]) > limits.moment_nm:
        return Refusal("force", f"{np.linalg.norm(wrench[3:]):.1f} Nm is over the cap")
    fastest = limits.withdraw_speed_m_s if state is State.RETREATING else limits.insertion_speed_m_s
    if (bounds[:3][selection[:3]] > fastest * 1.001).any():
        return Refusal("speed", "a compliant axis may move faster than allowed")
    if (bounds[3:][selection[3:]] > limits.insertion_turn_rad_s * 1.001).any():
        return Refusal("speed", "a compliant axis may turn faster than allowed")
    return None


# --- an inserted plug -----------------------------------------------------------------------------------------------


def _depth_m(T_base_tcp: Pose, T_base_port: Pose) -> float:
    """How far the plug's front face is behind the rim plane."""
    return -float(T_base_port.inverse().apply(T_base_tcp.translation)[2])


def plug_inserted(now: Situation) -> bool:
    """True unless the proximity contact says that the plug is out and, from contact on, the arm's pose says so too."""
    if now.charger is None or now.charger.proximity is not Proximity.ABSENT:
        return True
    if now.state not in IN_CONTACT:
        return False
    if now.T_base_port is None or now.arm is None:
        return True
    return not _depth_m(now.arm.T_base_tcp, now.T_base_port) <= CONTACT_DEPTH_M


def _check_inserted(command: Motion, now: Situation, limits: Limits) -> Refusal | None:
    """With the plug in: only along the port's axis, and out only when it is neither locked nor live."""
    if not plug_inserted(now) or now.arm is None:
        return None
    if now.state is State.RETREATING:
        if now.charger is None or now.charger.lock is not PlugLock.UNLOCKED:
            return Refusal("lock", "the plug is not known to be unlocked")
        if why := _live(now.charger):
            return Refusal("live", why)
    if isinstance(command, MoveJoints):
        return Refusal("inserted", "no joint motion while the plug is in the port")
    if now.T_base_port is None:
        return Refusal("inserted", "the axis on which the plug was inserted is not known")
    lateral = _lateral_travel_m(command, now.arm.T_base_tcp, now.T_base_port)
    if not lateral <= limits.capture_radius_m:
        return Refusal("inserted", f"{lateral * 1000:.1f} mm sideways while the plug is in the port")
    return None


def _lateral_travel_m(command: MoveLinear | MoveVelocity | Comply, T_base_tcp: Pose, T_base_port: Pose) -> float:
    """How far sideways of the port's axis a motion leads; a velocity counts for one second, a force for 0.1 m."""
    match command:
        case MoveLinear(T_base_tcp=target):
            return _sideways_m(T_base_tcp, target, T_base_port)
        case MoveVelocity(velocity=velocity):
            return float(np.linalg.norm(T_base_port.inverse().rotate(velocity[:3])[:2]))
        case Comply(compliance=compliance):
            axis = T_base_port.inverse().rotate(compliance.T_base_task.rotation[:, 2])
            return float(np.hypot(axis[0], axis[1])) * 0.1


def _sideways_m(start: Pose, end: Pose, T_base_port: Pose) -> float:
    """How far sideways of the port's axis one pose of the TCP is from another."""
    to_port = T_base_port.inverse()
    return float(np.linalg.norm((to_port.apply(end.translation) - to_port.apply(start.translation))[:2]))
