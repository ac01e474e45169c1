"""What one cell of the campaign showed, and the judgement by its rule. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from controller.campaign.rules import STAND_M, Arm, Rule

LAST_SECOND_S = 1.0


@dataclass(frozen=True, slots=True)
class Findings:
    """Facts of one run."""

    fault: str
    state: str
    made: bool
    """Whether the fault was made at all: the state was entered."""
    outcome: str
    code: str | None
    detail: str
    drift_m: float | None
    """How far the arm moved after it should have stood; None: no samples."""
    live_travel_m: float
    """How far the mated plug was moved while the contactor was closed."""
    clear: bool | None
    """Whether the arm ended clear of the vehicle; None: not known."""
    recorded_until_s: float
    """Time between the last readable sample of the recording and the end of the mission."""
    next_start: str
    """What the next start said."""
    next_travel_m: float | None
    """How far the arm moved in the next start; None: no samples."""
    duration_s: float


def violations(findings: Findings, rule: Rule) -> tuple[str, ...]:
    """Every way in which the run broke its rule; empty if none."""
    if not findings.made:
        return (f"the fault was not made: the mission ended as {findings.outcome} before {findings.state}",)
    found: list[str] = []
    codes = {code.value for code in rule.codes}
    if findings.outcome not in rule.kinds:
        found.append(f"outcome {findings.outcome} ({findings.code}), not {' or '.join(sorted(rule.kinds))}")
    elif codes and findings.code not in codes:
        found.append(f"fault code {findings.code} does not name the cause ({' or '.join(sorted(codes))})")
    if rule.arm in (Arm.STANDS, Arm.BACKS_OFF) and findings.drift_m is not None and findings.drift_m > STAND_M:
        found.append(f"the arm moved {1e3 * findings.drift_m:.1f} mm when it should have stood")
    if rule.arm is Arm.RETREATS and findings.clear is False:
        found.append("the arm did not end clear of the vehicle")
    if findings.live_travel_m > STAND_M:
        found.append(f"the plug moved {1e3 * findings.live_travel_m:.1f} mm under power")
    if rule.whole_recording and findings.recorded_until_s > LAST_SECOND_S:
        found.append(f"the recording lacks its last {findings.recorded_until_s:.1f} s")
    if findings.next_travel_m is not None and findings.next_travel_m > STAND_M:
        found.append(f"the arm moved {1e3 * findings.next_travel_m:.1f} mm in the next start's self-check")
    if not findings.next_start:
        found.append("the next start did not come up")
    return tuple(found)
