"""What can be wrong with the arm, each with its own code, so that an operator is told what to do about it."""

from __future__ import annotations

from drivers.base import CommandRejectedError, LinkLostError, LinkOpenError

# --- while opening ---------------------------------------------------------------------------------------------------


class ArmAbsentError(LinkOpenError):
    """Nothing at the address answers as a robot controller does."""

    code = "arm-absent"
    default_remedy = "Check the address in the configuration, the cable, and that the controller is switched on."


class LocalModeError(LinkOpenError):
    """The controller ignores programs from the network."""

    code = "arm-local-mode"
    default_remedy = "Switch the robot to remote control on its pendant."


class WrongModelError(LinkOpenError):
    """Another model than the configured one: its reach and limits would be wrong."""

    code = "arm-wrong-model"
    default_remedy = "Correct the model in the configuration, or the address if it is another robot."


class WrongSerialError(LinkOpenError):
    """Another robot than the configured one: its calibration would be wrong."""

    code = "arm-wrong-serial"
    default_remedy = "Correct the serial number in the configuration after a new calibration, or the address."


class ArmVersionError(LinkOpenError):
    """The controller's software version does not allow what the configuration asks for."""

    code = "arm-version"
    default_remedy = "Use PolyScope 5.6 or later on an e-Series controller."


class ArmNotReadyError(LinkOpenError):
    """Power is off, brakes are on, or the controller boots."""

    code = "arm-not-ready"
    default_remedy = "Power the arm on and release its brakes on the pendant."


class SafetyStopError(LinkOpenError):
    """A protective, safeguard or emergency stop is active; software never releases it."""

    code = "arm-safety-stop"
    default_remedy = "Find out why it stopped, make the cell safe, acknowledge on the pendant, then reset portdock."


class ForeignProgramError(LinkOpenError):
    """Another program is running on the controller."""

    code = "arm-program-running"
    default_remedy = "Stop the program on the pendant, or allow portdock to stop it (stop_running_program)."


class RegistersInUseError(LinkOpenError):
    """Another client owns the RTDE registers that are needed."""

    code = "arm-registers-in-use"
    default_remedy = (
        "Disable EtherNet/IP and PROFINET on the controller, end other RTDE clients, or use the upper register range."
    )


class ProgramStartError(LinkOpenError):
    """The control script was sent but does not run."""

    code = "arm-program-start"
    default_remedy = "Look for a pop-up or an error in the pendant's log, acknowledge it, then reset portdock."


class ReadBackError(LinkOpenError):
    """TCP or payload read back from the controller are not those that were set."""

    code = "arm-read-back"
    default_remedy = "Check TCP, payload and centre of gravity in the configuration against the robot's limits."


# --- while running ---------------------------------------------------------------------------------------------------


class ControlLinkLostError(LinkLostError):
    """The process that owns the control link crashed, hung or ended. The controller's watchdog stops the arm."""

    code = "arm-control-lost"
    default_remedy = "Check the robot's cable and network, then reset portdock."


class StateLinkLostError(LinkLostError):
    """The controller sends no state any more."""

    code = "arm-state-lost"
    default_remedy = "Check the robot's cable, network and power, then reset portdock."


class FrozenStateError(LinkLostError):
    """The link is up but the controller's own time stamp stands still."""

    code = "arm-state-frozen"
    default_remedy = "Check the network between portdock and the robot, then reset portdock."


# --- commands --------------------------------------------------------------------------------------------------------


class InvalidCommandError(CommandRejectedError):
    """Wrong length, a value that is not finite, or one beyond a configured limit."""

    code = "arm-invalid-command"
    default_remedy = "Check the limits of speed, force and workspace in the configuration."


class UnreachableError(CommandRejectedError):
    """The pose, or a part of the way to it, cannot be reached safely."""

    code = "arm-unreachable"
    default_remedy = "Move the robot's base or the vehicle so that the port is well within reach."


class CollisionError(CommandRejectedError):
    """The motion would bring the arm against itself or a known box."""

    code = "arm-collision"
    default_remedy = "Check the boxes in the configuration, or park so that the arm has room."


class ArmBusyError(CommandRejectedError):
    """Another motion is under way."""

    code = "arm-busy"
    default_remedy = "Stop the motion that is under way first."


class ProgramStoppedError(CommandRejectedError):
    """The control script is not running: watchdog, safety stop, or stopped by someone."""

    code = "arm-program-stopped"
    default_remedy = "Find out why it stopped, then reset portdock."
