"""Stage 1, links: each device answers at the address of the site file. Nothing moves, no laser, no power."""

from __future__ import annotations

import pytest

from controller.assembly import Assembly


@pytest.mark.parametrize("name", ["arm", "scanner", "charger"])
def test_the_link_is_up(live: Assembly, name: str) -> None:
    health = getattr(live.cell, name).health()
    assert health.up, health.detail


def test_the_port_model_is_ready(live: Assembly) -> None:
    assert len(live.model.points) > 100 and live.model.checksum
