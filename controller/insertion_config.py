"""The last centimetres as configuration: forces, speeds and bounds of contact, push, search and withdrawal.

One set holds for every port; ``per_port`` changes values for a port type by its name.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, field_serializer, model_validator

from controller.config_section import Section


class InsertionValues(Section):
    """One set of parameters."""

    # contact search
    contact_speed_mm_s: Annotated[float, Field(gt=0, le=20)] = 10.0
    """Speed of the search for contact."""
    contact_force_n: Annotated[float, Field(gt=0, le=50)] = 10.0
    """Axial force that counts as contact."""
    entered_mm: Annotated[float, Field(gt=0, le=20)] = 3.0
    """Deeper than this without contact force, the plug is on its way in: there is nothing to search."""

    # compliant push
    push_force_n: Annotated[float, Field(gt=0, le=100)] = 60.0
    """Axial force of the compliant push."""
    speed_limit_mm_s: Annotated[float, Field(gt=0, le=20)] = 15.0
    """Along the axis in force mode."""
    lateral_speed_limit_mm_s: Annotated[float, Field(gt=0, le=20)] = 10.0
    """Sideways in force mode."""
    tilt_speed_limit_deg_s: Annotated[float, Field(gt=0, le=5)] = 3.0
    """Of rotations in force mode."""
    max_axial_force_n: Annotated[float, Field(gt=0, le=150)] = 80.0
    """Cap: more than this ends the insertion."""
    max_lateral_force_n: Annotated[float, Field(gt=0, le=100)] = 30.0
    """Cap: more than this ends the insertion."""
    max_moment_nm: Annotated[float, Field(gt=0, le=20)] = 6.0
    """Cap: more than this ends the insertion."""
    overload_samples: Annotated[int, Field(ge=1, le=100)] = 3
    """So many samples in a row above a cap make an overload: a single one is noise."""
    seated_within_mm: Annotated[float, Field(gt=0, le=5)] = 1.0
    """The depth at rest may differ from the mated depth by this much."""
    plateau_s: Annotated[float, Field(gt=0, le=5)] = 0.3
    """The depth must stand still for so long to count as at rest."""
    progress_mm: Annotated[float, Field(gt=0, le=5)] = 0.3
    """Less depth than this within ``stall_s`` is no progress."""
    stall_s: Annotated[float, Field(gt=0, le=10)] = 1.0
    """No progress for so long is a stall."""

    # jam: no progress under this much lateral force or moment
    jam_lateral_n: Annotated[float, Field(gt=0, le=100)] = 12.0
    """Lateral force during a stall that makes it a jam."""
    jam_moment_nm: Annotated[float, Field(gt=0, le=20)] = 2.0
    """Moment during a stall that makes it a jam."""
    jam_retries: Annotated[int, Field(ge=0, le=5)] = 1
    """How often a jammed plug is eased and pushed again."""
    jam_relief_mm: Annotated[float, Field(gt=0, le=10)] = 1.5
    """How far it is eased back."""

    overrun_mm: Annotated[float, Field(gt=0, le=20)] = 4.0
    """Deeper than home by this much is no port as expected."""

    # search when the push stalls
    search_depth_mm: Annotated[float, Field(gt=0, le=50)] = 6.0
    """A plug that stalls deeper than this is in the port, and there is nothing to search."""
    search_radius_mm: Annotated[float, Field(gt=0, le=5)] = 2.0
    """Radius of the spiral."""
    search_pitch_mm: Annotated[float, Field(gt=0, le=3)] = 0.8
    """Distance between neighbouring turns of the spiral."""
    search_speed_mm_s: Annotated[float, Field(gt=0, le=5)] = 1.8
    """Along the spiral."""
    search_roll_deg: Annotated[float, Field(ge=0, le=5)] = 1.0
    """The plug is turned to and fro about its axis by this much while it searches."""
    search_roll_period_s: Annotated[float, Field(ge=0.5, le=20)] = 3.0
    """Of one turn to and fro."""
    search_push_n: Annotated[float, Field(gt=0, le=60)] = 15.0
    """Axial push while searching: enough to fall in, little enough to slide."""
    search_gain_mm: Annotated[float, Field(gt=0, le=10)] = 1.0
    """Depth gained while searching that counts as having found the way in."""
    search_s: Annotated[float, Field(gt=0, le=60)] = 15.0
    """A search that takes longer has failed."""

    # pulling out, also after an insertion that failed
    withdraw_start_force_n: Annotated[float, Field(gt=0, le=100)] = 30.0
    """The pull begins with this and grows only while nothing moves."""
    withdraw_step_n: Annotated[float, Field(gt=0, le=50)] = 20.0
    """How much the pull grows each time."""
    withdraw_force_n: Annotated[float, Field(gt=0, le=100)] = 70.0
    """The pull never exceeds this."""
    withdraw_speed_mm_s: Annotated[float, Field(gt=0, le=50)] = 25.0
    """Cap of the speed while pulling."""


class InsertionConfig(InsertionValues):
    """What happens within the last centimetres."""

    per_port: dict[str, InsertionValues] = Field(default_factory=dict)
    """Values that differ for a port type, by ``port.model`` (of a path the file's name alone)."""

    def on(self, port: str) -> InsertionConfig:
        """The values for a port, by its name."""
        special = self.per_port.get(port)
        if special is None:
            return self
        return self.model_copy(update={key: getattr(special, key) for key in special.model_fields_set})

    @model_validator(mode="after")
    def _within_the_cap(self) -> InsertionConfig:
        """A push that reaches its cap by itself would always end as an overload."""
        for port in ("", *self.per_port):
            values = self.on(port)
            for key in ("push_force_n", "search_push_n", "withdraw_force_n"):
                if getattr(values, key) > values.max_axial_force_n:
                    where = f" for {port}" if port else ""
                    raise ValueError(f"{key}{where} is above max_axial_force_n ({values.max_axial_force_n:g} N)")
        return self

    @field_serializer("per_port")
    def _only_what_differs(self, per_port: dict[str, InsertionValues]) -> dict[str, dict[str, Any]]:
        return {port: values.model_dump(exclude_unset=True) for port, values in per_port.items()}
