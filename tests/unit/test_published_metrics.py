"""Metrics (17), (19) to (22) on values worked out by hand, statistics, tables and the evaluation's trials."""

import numpy as np
import pytest

from perception.evaluation import figures, statistics
from perception.evaluation.cells import Cells
from perception.evaluation.methods import METHODS
from perception.evaluation.metrics import (
    Occupancy,
    angle_deg,
    centre_error_mm,
    common_loss,
    entry_errors,
    recognised,
)
from perception.evaluation.records import MergeRecord, RoundRecord, TrialRecord, append, read
from perception.evaluation.tables import condition_table, merge_table, table_1
from perception.evaluation.trials import COMPLETE
from perception.geometry import Pose


def test_entry_errors_are_those_worked_out_by_hand():
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    errors = entry_errors([Pose(quarter, np.array([3.0, 0, 0]))], [Pose.identity()])
    assert errors.rotation_mse == pytest.approx(4 / 9)  # four entries are off by one
    assert errors.rotation_mae == pytest.approx(4 / 9)
    assert errors.translation_mse == pytest.approx(9 / 3)
    assert errors.translation_mae == pytest.approx(1.0)
    assert errors.rotation_rmse**2 == pytest.approx(errors.rotation_mse)
    assert errors.translation_rmse**2 == pytest.approx(errors.translation_mse)


def test_the_common_loss_is_the_mean_squared_displacement_of_the_reference():
    reference = np.array([[0.0, 0, 0], [10, 0, 0]])
    assert common_loss(Pose.identity(), reference) == 0
    assert common_loss(Pose.from_rotvec([0, 0, 0], [3.0, 4.0, 0]), reference) == pytest.approx(25.0)
    assert common_loss(Pose.from_rotvec([0, 0, np.pi]), reference) == pytest.approx((0 + 400) / 2)


def test_angle_and_centre_error_are_independent_of_the_frames_origin():
    error = Pose.from_rotvec([0, 0, np.deg2rad(3.0)])
    assert angle_deg(error) == pytest.approx(3.0)
    assert centre_error_mm(error, np.zeros(3)) == 0
    assert centre_error_mm(error, np.array([100.0, 0, 0])) == pytest.approx(2 * 100 * np.sin(np.deg2rad(1.5)))


def test_recognition_needs_both_angle_and_place():
    assert recognised(1.9, 1.9)
    assert not recognised(2.1, 0.1)
    assert not recognised(0.1, 2.1)
    assert recognised(4.0, 4.0, within=5.0)


def test_iou_of_a_cloud_with_itself_is_one_with_something_elsewhere_zero_and_it_is_symmetric():
    rng = np.random.default_rng(0)
    a = rng.uniform(0, 50, (500, 3))
    a[0] = 0.0  # the grid's corner, for both
    b = a.copy()
    b[: len(b) // 2] = rng.uniform(0, 50, (len(b) // 2, 3))
    b[0] = 0.0
    assert Occupancy(a, 3.0).iou(a) == 1.0
    assert Occupancy(a, 3.0).iou(a + 1000.0) == 0.0
    assert Occupancy(a, 3.0).iou(b) == pytest.approx(Occupancy(b, 3.0).iou(a))
    assert 0.2 < Occupancy(a, 3.0).iou(b) < 0.9


def test_iou_counts_cells():
    target = np.array([[0.0, 0, 0], [4, 0, 0], [8, 0, 0]])
    assert Occupancy(target, 3.0).iou(np.array([[1.0, 1, 1], [5, 1, 1], [1, 1, 7]])) == pytest.approx(2 / 4)


def test_bootstrap_intervals_hold_the_value_and_are_repeatable():
    values = np.random.default_rng(1).exponential(1.0, 40).tolist()
    found = statistics.median(values)
    assert found == statistics.median(values)
    assert found.low < found.value < found.high
    assert found.n == 40
    assert statistics.mean([1.0, 1.0]).high == 1.0


def record(method, trial, loss, *, iou=0.4, ms=5.0, shift=0.0):
    rounds = tuple(RoundRecord(loss * k, 0.1, 0.1, iou, iou, ms) for k in (2.0, 1.0))
    off = (shift / 100,) * 9, (shift, 0.0, 0.0)
    return TrialRecord(COMPLETE.name, trial, method, rounds, *off, 0.55, 0.6, 0.3, 0.44, 0.6, 0.77)


def test_table_1_shows_ours_beside_the_papers_figure_and_the_ceiling():
    records = [record(name, n, 1.0) for name in ("faithful", "robust") for n in range(3)]
    records += [record("b1", n, 4.0, iou=0.32) for n in range(3)] + [record("b2", n, 2.0) for n in range(3)]
    records += [record("b1-28", n, 8.0, ms=7.0) for n in range(3)]
    text = table_1(Cells.of(records)).markdown()
    loss = next(line for line in text.splitlines() if "loss against" in line)
    for part in ("58.73 %", "+75.0 %", "66.89 %", "+50.0 %", "10, 10, 10"):
        assert part in loss
    many = next(line for line in text.splitlines() if "loss against" in line and "28 starts" in line)
    assert "+87.5 %" in many  # against the baseline 1 that had the same 28 starts
    assert "10, 14, 10" in many  # milliseconds that each spent
    iou = next(line for line in text.splitlines() if line.startswith("| IOU"))
    assert "+25.0 % (+8 points)" in iou
    assert "ceiling 0.55" in iou
    assert "0.400 / 0.550" in condition_table(Cells.of(records), COMPLETE).markdown()


def test_a_method_that_takes_fewer_rounds_keeps_its_answer():
    one = record("faithful", 0, 1.0)
    assert (one.after(1).loss_mm2, one.after(2).loss_mm2, one.after(9).loss_mm2) == (2.0, 1.0, 1.0)


def test_results_survive_a_line_that_was_cut_off(tmp_path):
    path = tmp_path / "results.jsonl"
    append(path, [record("b1", 0, 1.0), record("b2", 0, 1.0)])
    with path.open("a") as file:
        file.write('{"kind": "TrialRec')
    assert read(path) == [record("b1", 0, 1.0), record("b2", 0, 1.0)]


def test_entry_errors_of_a_cell_are_over_all_trials_with_an_interval():
    cell = Cells.of([record("b1", n, 1.0, shift=shift) for n, shift in enumerate((3.0, -3.0, 0.0, 6.0))]).cells[0]
    _, _, _, mse, rmse, mae = cell.entries()
    assert mse.value == pytest.approx((9 + 9 + 0 + 36) / 12)
    assert rmse.value**2 == pytest.approx(mse.value)
    assert mae.value == pytest.approx((3 + 3 + 0 + 6) / 12)
    for entry in (mse, rmse, mae):
        assert entry.low < entry.value < entry.high


def test_figures_hold_every_profile_baseline_and_yardstick_and_within_a_panel_all_have_the_same_starts():
    (_, one), (_, many) = figures._PANELS
    groups = {entry.name: entry.group for entry in METHODS}
    assert {groups[name] for name in one} == {"one start"}
    assert {groups[name] for name in many} == {"28 starts", "global"}
    assert {*one, *many} == {name for name, group in groups.items() if group != "control"}


def test_all_figures_are_drawn_as_png_and_svg_with_every_method_named(tmp_path):
    names = [entry.name for entry in METHODS if entry.group != "control"]
    cells = Cells.of([record(name, n, 1.0 + n, shift=0.1 * n + 0.1) for name in names for n in range(2)])
    paths = figures.write_figures(cells, tmp_path)
    assert sorted(path.suffix for path in paths) == [".png"] * 5 + [".svg"] * 5
    for path in paths:
        assert path.stat().st_size > 5000
        if path.suffix == ".svg":
            for label in ("literal", "faithful", "robust", "baseline 1", "baseline 2", "RANSAC", "FGR", "28 starts"):
                assert label in path.read_text()


def test_the_merge_table_tells_each_views_error_and_then_that_of_all():
    worst = {1: 0.2, 2: 0.8}
    records = [MergeRecord(n, 0, "joint", 0.0, 0.0) for n in range(3)]  # the reference says nothing
    records += [MergeRecord(n, view, "joint", 0.1, mm) for n in range(3) for view, mm in worst.items()]
    rows = [dict(zip(merge_table(records).header, row, strict=True)) for row in merge_table(records).rows]
    assert [(row["view"], row["trials"], row["centre worst (mm)"]) for row in rows] == [
        ("2", "3", "0.2"),
        ("3", "3", "0.8"),
        ("all", "3", "0.8"),
    ]
    assert [row["centre median (mm)"] for row in rows[:2]] == ["0.2", "0.8"]
