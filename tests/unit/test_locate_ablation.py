"""The published steps beside the default locator: each variant does what its name says."""

from __future__ import annotations

import multiprocessing
import time
from dataclasses import replace

import numpy as np
import pytest

from controller.port_files import bundled_ports, load_port
from controller.port_models import port_model
from perception.evaluation import locate_ablation
from perception.evaluation.locate_ablation import VARIANTS, cleaned
from perception.evaluation.locate_cases import Case, CaseScan, make_scan
from perception.evaluation.locate_records import CaseRecord
from perception.evaluation.locate_solvers import PORTDOCK
from perception.evaluation.locate_tables import ablation_table
from perception.evaluation.processes import workers
from perception.locate import LocateSettings
from perception.published.profiles import FAITHFUL
from perception.scan import Cloud

SHAPES = {name: load_port(name).shape for name in bundled_ports()}


@pytest.fixture(scope="module")
def scan() -> CaseScan:
    return make_scan(Case("port", 0, "nominal", "ccs2", "ccs2"), 5, SHAPES)


def test_cleaning_removes_flying_points_with_their_origins_and_keeps_the_surface(scan: CaseScan) -> None:
    rng = np.random.default_rng(1)
    low, high = scan.cloud.points.min(axis=0), scan.cloud.points.max(axis=0)
    flying = rng.uniform(low - 0.1, high + 0.1, (300, 3))
    origins = scan.cloud.origins
    assert origins is not None
    dirty = Cloud(np.vstack([scan.cloud.points, flying]), "scanner", np.vstack([origins, origins[:300]]))
    clean = cleaned(dirty, 2.0)
    assert clean.origins is not None
    assert len(clean.origins) == len(clean)
    left = {tuple(point) for point in clean.points}
    assert sum(tuple(point) in left for point in flying) < 30
    assert sum(tuple(point) in left for point in scan.cloud.points[::100]) > 0.8 * len(scan.cloud) / 100


@pytest.mark.parametrize("name", ["denoised", "keypoints", "fed-back"])
def test_a_variant_finds_a_port_that_is_well_seen(scan: CaseScan, name: str) -> None:
    found = VARIANTS[name](scan, port_model("ccs2"), LocateSettings())
    assert scan.T_scanner_port is not None
    assert found.accepted, found.reasons
    assert found.T_ref_port.distance_to(scan.T_scanner_port) < 0.0005


def test_keypoints_alone_have_no_place_but_the_methods_own(scan: CaseScan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locate_ablation, "_by_keypoints", lambda scene, model: [])
    found = locate_ablation.VARIANTS["keypoints-alone"](scan, port_model("ccs2"), LocateSettings())
    assert not found.accepted
    assert found.reasons == ("nothing within the prior's bounds resembles the port",)


def test_what_is_accepted_is_not_looked_at_again(scan: CaseScan, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise AssertionError("cleaned although the evidence sufficed")

    monkeypatch.setattr(locate_ablation, "cleaned", never)
    assert VARIANTS["fed-back"](scan, port_model("ccs2"), LocateSettings()).accepted


def test_what_is_refused_is_cleaned_by_the_losss_kappa_and_looked_at_again(
    scan: CaseScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = VARIANTS["fed-back"](scan, port_model("ccs2"), LocateSettings())
    answers = [replace(right, accepted=False), right]
    kappas: list[float] = []
    monkeypatch.setattr(locate_ablation, "locate", lambda *_: answers.pop(0))
    monkeypatch.setattr(locate_ablation, "cleaned", lambda cloud, kappa: (kappas.append(kappa), cloud)[1])
    assert VARIANTS["fed-back"](scan, port_model("ccs2"), LocateSettings()) is right
    (kappa,) = kappas
    assert 0.0 < kappa <= FAITHFUL.feedback.kappa_0


def test_a_refused_scan_without_points_at_the_port_stays_refused(scan: CaseScan) -> None:
    empty = replace(scan, cloud=Cloud(scan.cloud.points[:200] + 5.0))
    assert not VARIANTS["fed-back"](empty, port_model("ccs2"), LocateSettings()).accepted


def test_variants_are_compared_on_the_scans_that_all_were_given() -> None:
    def record(case: str, solver: str, error: float) -> CaseRecord:
        return CaseRecord(
            case, "port", "nominal", "ccs2", "ccs2", solver, 1, 1.0, True, "port", "ccs2", (),
            (error, 0.0, 0.0, 0.0, 0.0, 0.0), (), 1e-5, 1e-4, 1.0, 1.0, 1.0, 1.0,
        )  # fmt: skip

    records = [record("a", PORTDOCK, 0.0), record("b", PORTDOCK, 0.005), record("a", "denoised", 0.0)]
    table = ablation_table(records)
    assert [row[0] for row in table.rows] == [PORTDOCK, "denoised"]
    assert all(row[1].startswith("1/1") for row in table.rows)
    assert ablation_table(records[:2]).rows == ()


def test_an_error_ends_the_workers_at_once() -> None:
    begun = time.monotonic()
    with pytest.raises(ValueError, match="one case failed"), workers(2) as pool:
        for _ in range(20):
            pool.submit(time.sleep, 60.0)
        raise ValueError("one case failed")
    for process in multiprocessing.active_children():
        process.join(timeout=30.0)
    assert time.monotonic() - begun < 60.0
