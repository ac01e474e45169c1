"""What RTDE clients write: registers, digital and analog outputs by mask, the speed slider."""

from __future__ import annotations

from collections.abc import Mapping

from mocks.ur.state import InputsOutputs, Registers

Values = Mapping[str, tuple[float, ...]]
"""By variable name, as unpacked from a data package."""


def write_registers(registers: Registers, values: Values) -> None:
    """General purpose input registers."""
    for name, value in values.items():
        if name.startswith("input_int_register_"):
            registers.in_int[int(name[19:])] = int(value[0])
        elif name.startswith("input_double_register_"):
            registers.in_double[int(name[22:])] = value[0]
        elif name.startswith("input_bit_register"):
            first, width = _bits(name)
            mask = ((1 << width) - 1) << first
            registers.in_bits = registers.in_bits & ~mask | (int(value[0]) << first) & mask


def write_outputs(io: InputsOutputs, values: Values) -> None:
    """Outputs whose mask is set."""
    for name, shift in (("standard", 0), ("configurable", 8), ("tool", 16)):
        mask = _first(values, f"{name}_digital_output_mask") << shift
        bits = _first(values, f"{name}_digital_output") << shift
        io.digital_out = io.digital_out & ~mask | bits & mask
    mask = _first(values, "standard_analog_output_mask")
    for k in (0, 1):
        if mask >> k & 1:
            io.analog[k] = values.get(f"standard_analog_output_{k}", (0.0,))[0]
    if "standard_analog_output_type" in values:
        io.analog_types = io.analog_types & ~(mask << 2) | (_first(values, "standard_analog_output_type") & mask) << 2


def slider(values: Values, present: float) -> float:
    """The speed slider after these values, 0 to 1."""
    if not _first(values, "speed_slider_mask") & 1:
        return present
    return max(0.0, min(1.0, values.get("speed_slider_fraction", (present,))[0]))


def _first(values: Values, name: str) -> int:
    return int(values.get(name, (0,))[0])


def _bits(name: str) -> tuple[int, int]:
    """First bit and width of a bit register's name."""
    if name == "input_bit_registers0_to_31":
        return 0, 32
    if name == "input_bit_registers32_to_63":
        return 32, 32
    return int(name[19:]), 1
