"""What has the port's outline and is not the port: without contacts, or its mirror image. Each was accepted once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.port_files import bundled_ports, load_port
from perception.estimate import Prior
from perception.evaluation.families import OTHERS, drawn_mesh
from perception.evaluation.locate_cases import Case, make_scan
from perception.evidence import Evidence
from perception.gate import Findings, reasons_against
from perception.geometry import Pose
from perception.locate import locate
from perception.port_model import AcceptanceLimits, PortModel
from perception.port_solid import build_mesh

GOOD = Evidence(1000.0, 0.0, 0.0, 0.8, 10, 10, 0, 0.6, 0.0, 100, 0, 1.0, contacts=3, contacts_seen=3)


def reasons(evidence: Evidence) -> tuple[str, ...]:
    findings = Findings(Pose.identity(), np.diag([1e-10] * 6), 1e-4, evidence, 0.5)
    return reasons_against(findings, Prior(Pose.identity()), AcceptanceLimits())


@pytest.fixture(scope="module")
def trilobe() -> PortModel:
    return PortModel.from_mesh("trilobe", *drawn_mesh(OTHERS["trilobe"]))


@pytest.mark.parametrize(
    ("case", "reason"),
    [
        (Case("no-contacts", 8, "easy", "trilobe", "trilobe"), ("contacts is seen", "contacts are not where")),
        (Case("no-contacts", 206, "hard", "trilobe", "trilobe"), ("contacts is seen", "contacts are not where")),
        (Case("mirrored", 359, "extreme", "trilobe", "trilobe"), ("mirror image",)),
    ],
    ids=lambda value: value.name if isinstance(value, Case) else "",
)
def test_an_impostor_is_refused_and_the_reason_says_what_is_missing(
    trilobe: PortModel, case: Case, reason: tuple[str, ...]
) -> None:
    scan = make_scan(case, 62, OTHERS)
    found = locate(scan.cloud, trilobe, scan.prior)
    assert not found.accepted
    assert any(one in text for text in found.reasons for one in reason), found.reasons


def test_contacts_decide_by_themselves_however_many_other_features_are_seen() -> None:
    assert reasons(GOOD) == ()
    assert "none of the 3 contacts is seen" in reasons(replace(GOOD, contacts_seen=0))[0]
    assert (
        "2 contacts are not where they should be, 1 are seen"
        in reasons(replace(GOOD, contacts_seen=1, contacts_denied=2))[0]
    )
    assert reasons(replace(GOOD, contacts=1, contacts_seen=0)) == ()


def test_a_port_that_is_not_its_mirror_image_must_show_it() -> None:
    assert reasons(replace(GOOD, mirror=(40, 1))) == ()
    assert "hardly any point tells this port from its mirror image" in reasons(replace(GOOD, mirror=(3, 0)))[0]
    assert "its mirror image explains the scan as well" in reasons(replace(GOOD, mirror=(40, 30)))[0]


def test_bundled_ports_are_their_own_mirror_image_and_trilobe_is_not(trilobe: PortModel) -> None:
    handed = {n: PortModel.from_mesh(n, *build_mesh(load_port(n).shape)).handed for n in bundled_ports()}
    assert not any(handed.values()), handed
    assert trilobe.handed
    assert list(trilobe.contacts) == [1, 2, 3]
