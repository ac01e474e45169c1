"""The site configuration: what a typo, a wrong bound or broken YAML leads to."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from controller.config import as_yaml, load_config, parse_config
from controller.config_keys import json_schema, keys, listing
from controller.config_layers import layers
from controller.config_section import ConfigError
from drivers.arm.settings import MotionCaps


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "site.yaml"
    path.write_text(text)
    return path


def test_the_defaults_place_the_port_in_front_of_the_robot_facing_it() -> None:
    pose = load_config().port.T_base_port.pose
    np.testing.assert_allclose(pose.rotation[:, 2], [-1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(pose.rotation[:, 1], [0, 0, 1], atol=1e-6)


def test_a_site_file_overrides_only_what_it_names(tmp_path: Path) -> None:
    config = load_config(written(tmp_path, "arm: {host: 10.0.0.7}\n"))
    assert config.arm.host == "10.0.0.7"
    assert config.arm.T_flange_tcp.xyz_mm == (0.0, 0.0, 200.0)


def test_an_unknown_key_is_refused_and_the_nearest_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(written(tmp_path, "insertion: {push_forse_n: 20}\n"))
    assert caught.value.cause == "unknown key 'insertion.push_forse_n'"
    assert "'push_force_n'" in caught.value.remedy


def test_an_unknown_section_is_refused_and_the_nearest_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="unknown key 'scaner'") as caught:
        load_config(written(tmp_path, "scaner: {}\n"))
    assert "scanner" in caught.value.remedy


@pytest.mark.parametrize(
    ("text", "cause", "remedy"),
    [
        ("insertion: {push_force_n: 400}", "insertion.push_force_n is 400 N", "<= 100 N"),
        ("scan: {speed_mm_s: 0}", "scan.speed_mm_s is 0 mm/s", "> 0 mm/s"),
        ("motion: {joint_acceleration_deg_s2: 999}", "is 999 deg/s^2", "<= 170 deg/s^2"),
    ],
)
def test_a_value_out_of_bounds_names_bound_and_unit(tmp_path: Path, text: str, cause: str, remedy: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(written(tmp_path, text))
    assert cause in caught.value.cause
    assert remedy in caught.value.remedy


def test_broken_yaml_names_the_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="line 3"):
        load_config(written(tmp_path, "arm:\n  host: [1, 2\n"))


@pytest.mark.parametrize("text", ["- 1\n- 2\n", "just text"])
def test_yaml_that_is_no_mapping_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError, match="not a YAML mapping"):
        load_config(written(tmp_path, text))


def test_nan_is_no_value(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"push_force_n"):
        load_config(written(tmp_path, "insertion: {push_force_n: .nan}"))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.yaml"):
        load_config(tmp_path / "nowhere.yaml")


def test_the_effective_configuration_reads_back_as_itself(tmp_path: Path) -> None:
    config = load_config()
    assert load_config(written(tmp_path, as_yaml(config))) == config


def test_an_empty_configuration_has_a_value_for_every_key() -> None:
    assert parse_config({}).mission.max_attempts >= 1


def test_every_key_says_what_it_means() -> None:
    assert [key.name for key in keys() if not key.doc] == []


def test_every_quantity_is_bounded() -> None:
    free = {"centre_mm", "xyz_mm", "rotvec_deg", "centre_of_gravity_mm", "workspace_min_mm", "workspace_max_mm"}
    free |= {"joint_min_deg", "joint_max_deg", "a_mm", "d_mm", "zeros_deg"}  # bounded item by item
    open_ended = [key.name for key in keys() if key.unit and not key.bounds and key.name.rpartition(".")[2] not in free]
    assert open_ended == []


def test_no_speed_that_a_site_may_ask_for_is_refused_by_the_arms_driver() -> None:
    motion = json.loads(json_schema())["$defs"]["MotionConfig"]["properties"]
    caps = MotionCaps()
    assert np.deg2rad(motion["joint_speed_deg_s"]["maximum"]) <= caps.joint_speed_rad_s
    assert np.deg2rad(motion["joint_acceleration_deg_s2"]["maximum"]) <= caps.joint_acceleration_rad_s2
    for speed in ("linear_speed_mm_s", "approach_speed_mm_s"):
        assert motion[speed]["maximum"] <= caps.tcp_speed_m_s * 1000.0
    assert motion["acceleration_mm_s2"]["maximum"] <= caps.tcp_acceleration_m_s2 * 1000.0


def test_the_listing_names_the_origin_of_each_value_and_is_itself_a_site_file(tmp_path: Path) -> None:
    site = written(tmp_path, "arm: {host: 10.0.0.7}\n")
    text = listing(load_config(site), layers(site), with_docs=True)
    assert f"host: 10.0.0.7  # {site}" in text
    assert "model: ur10e  # default.yaml" in text
    assert "along_mm: 30.0  # built in" in text
    assert "# (mm/s; > 0, <= 100) Speed of the sweep." in text
    assert load_config(written(tmp_path, text)) == load_config(site)


def test_the_schema_holds_bounds_and_units_and_forbids_unknown_keys() -> None:
    schema = json.loads(json_schema())
    speed = schema["$defs"]["ScanConfig"]["properties"]["speed_mm_s"]
    assert speed["exclusiveMinimum"] == 0
    assert speed["description"].startswith("[mm/s]")
    assert not schema["$defs"]["ScanConfig"]["additionalProperties"]


def test_a_section_that_the_site_does_not_have_is_explained_all_the_same() -> None:
    shown = listing(load_config(), layers(None), with_docs=True)
    assert "coarse: null" in shown
    assert "#   lateral_mm: (mm; > 0, <= 250) How far sideways" in shown
