"""Stage 3, laser: on, profiles, off. Nothing moves; THE LASER IS ON for some seconds."""

from __future__ import annotations

import numpy as np

from controller.assembly import Assembly
from perception.scan import Profile
from tests.hil.conftest import Announce
from tests.hil.patience import until


def test_the_laser_gives_profiles_and_goes_off_again(live: Assembly, announce: Announce) -> None:
    announce("The scanner's laser will be on for some seconds. Nothing moves. Do not look into it.")
    scanner = live.cell.scanner
    profiles: list[Profile] = []

    def enough() -> bool:
        profiles.extend(scanner.take())
        return len(profiles) >= 50

    scanner.start()
    try:
        until(enough, "50 profiles")
    finally:
        scanner.stop()
    numbers = [profile.sequence for profile in profiles]
    lost = numbers[-1] - numbers[0] + 1 - len(numbers)
    assert lost <= 0.05 * len(numbers), f"{lost} of {len(numbers)} profiles lost: check the cable and the baud rate"
    assert all(np.isfinite(profile.points).all() for profile in profiles)
    times_s = [profile.time_s for profile in profiles]
    assert times_s == sorted(times_s)
    scanner.take()
    assert scanner.health().up
