"""A scanner too coarse to dock with is told before anything moves; one that is good enough is not."""

from __future__ import annotations

from pathlib import Path

import pytest

from controller.cli.main import exit_code
from controller.config import SiteConfig, load_config
from controller.port_files import load_port
from controller.precision import ScannerTooCoarseError, predict, refuse_too_coarse
from controller.scanner_config import ScannerConfig, ScipConfig
from controller.scanner_facts import scanner_facts


def site(**scanner: object) -> SiteConfig:
    base = load_config()
    return base.model_copy(update={"scanner": ScannerConfig.model_validate({"device": "/dev/null"} | scanner)})


def test_a_scip_range_finder_alone_is_refused_with_the_figure() -> None:
    with pytest.raises(
        ScannerTooCoarseError, match=r"good to 17\.\d mm and 9\.\d deg \(1 sigma\).*allows 0\.50 mm"
    ) as caught:
        refuse_too_coarse(site(protocol="scip"))
    assert "triangulating profiler" in caught.value.remedy
    assert exit_code(caught.value) == 2


def test_the_noise_model_decides_not_the_protocols_name() -> None:
    refuse_too_coarse(site(protocol="scip", scip={"range_noise_um": 100, "systematic_um": 50}))
    with pytest.raises(ScannerTooCoarseError):
        refuse_too_coarse(site(protocol="profiler2", profiler2={"systematic_um": 800}))


def test_a_toy_lidar_described_in_yaml_is_refused_too() -> None:
    with pytest.raises(ScannerTooCoarseError, match="LDROBOT"):
        refuse_too_coarse(site(format="ld19"))


def test_both_bundled_precise_scanners_may_dock() -> None:
    refuse_too_coarse(load_config())
    refuse_too_coarse(load_config(scanner="profiler2"))


def test_averaging_helps_against_noise_and_not_against_what_points_share() -> None:
    shape = load_port("ccs2").shape

    def sigma_m(noise_um: float, systematic_um: float) -> float:
        scip = ScipConfig(range_noise_um=noise_um, systematic_um=systematic_um)
        scanner = ScannerConfig(protocol="scip", scip=scip)
        return predict(scanner_facts(scanner), load_config().scan, shape).translation_m

    assert sigma_m(10_000, 0) < 1e-3
    assert sigma_m(0, 10_000) == pytest.approx(17.3e-3, rel=0.01)


def test_a_mission_with_it_ends_before_a_device_is_opened(tmp_path: Path) -> None:
    from controller.session import run_session

    with pytest.raises(ScannerTooCoarseError):
        run_session(site(protocol="scip"), tmp_path / "run", None)  # type: ignore[arg-type]
    assert not (tmp_path / "run").exists()
