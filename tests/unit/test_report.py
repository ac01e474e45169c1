"""The report tells what happened from the recording alone, and loads nothing from anywhere."""

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from controller.recording.errors import RecordingFileError
from controller.recording.reader import read_recording
from controller.recording.recorder import Recorder
from controller.reports.facts import alignment, insertion_traces, state_spans, surface_distance
from controller.reports.html import ReportError
from controller.reports.locate import write_report as write_locate_report
from controller.reports.mission import render_report, write_report
from controller.summary import LocateSummary, MissionSummary
from drivers.base import LinkHealth
from perception.estimate import Prior
from perception.geometry import Pose
from perception.port_model import PortModel
from perception.scan import Cloud
from tests.unit.recording_samples import (
    T_BASE_PORT,
    ManualClock,
    arm_state,
    estimate,
    model_points,
    model_points_npz,
    new_recorder,
    record_mission,
    scan_cloud,
    summary,
)


class Page(HTMLParser):
    """Text, addresses, tags and nesting of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.addresses: list[str] = []
        self.tags: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "action", "srcset")]
        if tag not in ("meta", "img", "br", "link", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, f"</{tag}> closes something else"

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def charged(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = record_mission(tmp_path_factory.mktemp("m") / "mission.mcap")
    return write_report(path, path.parent / "report.html").read_text()


def refused_mission(path: Path, reasons: tuple[str, ...]) -> Path:
    clock = ManualClock()
    recorder = new_recorder(path, clock)
    recorder.transition("OFFLINE", "started", "SELF_CHECK", 0.0)
    recorder.command("MoveL", "to <staging>", allowed=False, reason="speed above its limit")
    clock.sleep(2.0)
    recorder.estimate(estimate(accepted=False, reasons=reasons))
    located = LocateSummary(False, None, None, 0.4, reasons)
    recorder.close(MissionSummary("refused", "port-not-found", "Check the cover.", (("SELF_CHECK", 2.0),), 1, located))
    return path


def test_the_key_facts_are_in_the_text(charged: str) -> None:
    text = Page(charged).text
    for fact in (
        "Charged",
        "2025-10-09 08:53:20 UTC",
        "port ccs2",
        "0.25 mm located pose against truth",
        "62 N peak force",
        "accepted, port",
        "all checks passed",
        "bytes 4,096, bad checksum 2",
        "max_force_n: 80",
        "located the port",
        "portdock is not a safety function",
    ):
        assert fact in text, fact
    assert "inserting_done" in text


def test_every_picture_is_inside_and_is_a_picture(charged: str) -> None:
    page = Page(charged)
    assert len(page.addresses) == 5
    for address in page.addresses:
        kind, data = address.split(";base64,")
        start = base64.b64decode(data)[:300]
        assert start.startswith(b"\x89PNG") if kind == "data:image/png" else b"<svg" in start or b"<?xml" in start


def test_nothing_is_loaded_and_nothing_runs(charged: str) -> None:
    page = Page(charged)
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    assert all(address.startswith("data:image/") for address in page.addresses)
    assert not re.search(r"https?://|url\(|@import|\son\w+=", charged)
    assert page.open == []


def test_a_refusal_says_why_and_what_to_do(tmp_path: Path) -> None:
    path = refused_mission(tmp_path / "m.mcap", ("rim covered by <snow> & ice",))
    html = write_report(path, tmp_path).read_text()
    text = Page(html).text
    assert "port-not-found : rim covered by <snow> & ice" in text.replace("port-not-found:", "port-not-found :")
    assert "Check the cover." in text
    assert "refused, port" in text
    assert "speed above its limit" in text
    assert "<snow>" not in html


def test_a_mission_that_was_killed_still_gets_a_report(tmp_path: Path) -> None:
    whole = record_mission(tmp_path / "m.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    text = Page(write_report(tmp_path / "cut.mcap", tmp_path).read_text()).text
    assert "Unfinished" in text
    assert "breaks off at byte" in text


def test_an_empty_recording_still_gets_a_report(tmp_path: Path) -> None:
    Recorder(tmp_path / "m.mcap", ManualClock()).close()
    text = Page(write_report(tmp_path / "m.mcap", tmp_path).read_text()).text
    assert "no transition recorded" in text


def test_lost_samples_are_told(tmp_path: Path) -> None:
    recorder = new_recorder(tmp_path / "m.mcap", backlog_bytes=0)
    recorder.scanner_bytes("rx", b"x", 1)
    recorder.link("charger", LinkHealth(False, None, (), "silent"))
    recorder.close()
    text = Page(render_report(read_recording(tmp_path / "m.mcap"))).text
    assert "1 messages of /scanner/rx were not recorded." in text
    assert "charger down silent" in text


def test_no_recording_no_report_and_nothing_half_written(tmp_path: Path) -> None:
    with pytest.raises(RecordingFileError):
        write_report(tmp_path / "none.mcap", tmp_path / "report.html")
    assert list(tmp_path.iterdir()) == []


def test_a_report_that_cannot_be_written_is_one_clear_error(tmp_path: Path) -> None:
    path = refused_mission(tmp_path / "m.mcap", ())
    (tmp_path / "file").write_text("")
    with pytest.raises(ReportError, match="cannot write the report"):
        write_report(path, tmp_path / "file" / "report.html")


def test_spans_follow_the_transitions_and_end_with_the_recording(tmp_path: Path) -> None:
    spans = state_spans(read_recording(record_mission(tmp_path / "m.mcap")))
    assert [s.state for s in spans][:3] == ["SELF_CHECK", "READY", "STAGING"]
    assert np.allclose([s.start_s for s in spans], range(12))
    assert np.isclose(spans[-1].end_s, 12.0)
    assert spans[0].event == "self_check_done"


def test_depth_and_force_are_those_of_the_port_frame(tmp_path: Path) -> None:
    clock = ManualClock()
    recorder = new_recorder(tmp_path / "m.mcap", clock)
    recorder.transition("READY", "go", "LOCATING", 0.0)
    recorder.estimate(estimate())
    recorder.estimate(replace(estimate(accepted=False), T_ref_port=Pose.identity()))
    recorder.transition("LOCATING", "located", "INSERTING", 0.0)
    pushed = T_BASE_PORT.moved((0.001, 0.0, -0.012))
    for _ in range(5):
        clock.sleep(0.1)
        recorder.arm_state(arm_state(clock.now_s(), pushed, force_n=35.0))
    recorder.transition("INSERTING", "seated", "VERIFYING", 0.0)
    clock.sleep(0.1)
    recorder.arm_state(arm_state(clock.now_s(), pushed, force_n=20.0))
    recorder.close()
    (trace,) = insertion_traces(read_recording(tmp_path / "m.mcap"))
    assert np.allclose(trace.depth_mm, 12.0)
    assert np.allclose(trace.axial_n, [35.0] * 5 + [20.0])
    assert np.allclose(trace.lateral_n, 0.0, atol=1e-9)
    assert np.allclose(trace.time_s, np.arange(1, 7) * 0.1)


def test_each_attempt_is_a_trace_of_its_own(tmp_path: Path) -> None:
    clock = ManualClock()
    recorder = new_recorder(tmp_path / "m.mcap", clock)
    recorder.estimate(estimate())
    for _ in range(3):
        for state in ("INSERTING", "RETREATING"):
            clock.sleep(0.1)
            recorder.transition("X", "e", state, 0.0)
            for _ in range(4):
                clock.sleep(0.1)
                recorder.arm_state(arm_state(clock.now_s()))
    recorder.close(summary())
    traces = insertion_traces(read_recording(tmp_path / "m.mcap"))
    assert [t.attempt for t in traces] == [1, 2, 3]
    assert all(len(t.time_s) == 4 for t in traces)


def test_a_scan_off_the_model_by_a_millimetre_shows_a_millimetre() -> None:
    model = model_points()
    flat = model[(model[:, 2] == 0.0) & (np.abs(model[:, :2]).max(axis=1) < 0.045)]
    lifted = flat + np.array([0.0, 0.0, 0.001])
    assert np.allclose(np.median(surface_distance(lifted, model)), 0.001, atol=5e-5)
    assert np.median(surface_distance(flat + np.array([0.0004, 0.0, 0.0]), model)) < 5e-5
    assert np.isinf(surface_distance(flat + np.array([0.0, 0.0, 0.02]), model)).all()


def test_the_alignment_takes_the_last_scan_before_the_last_estimate(tmp_path: Path) -> None:
    clock = ManualClock()
    recorder = new_recorder(tmp_path / "m.mcap", clock)
    recorder.attach("model_points.npz", model_points_npz(), "application/x-npz")
    recorder.scan(scan_cloud().transformed(Pose.from_vector([1.0, 0, 0, 0, 0, 0]), "base"))
    recorder.estimate(replace(estimate(accepted=False), T_ref_port=Pose.identity()))
    clock.sleep(1.0)
    recorder.scan(scan_cloud())
    recorder.estimate(estimate())
    recorder.close()
    view = alignment(read_recording(tmp_path / "m.mcap"))
    assert view is not None
    assert view.near.mean() > 0.99
    assert np.median(view.distance_m[view.near]) < 0.0003


@pytest.mark.parametrize("broken", [b"", b"no npz", b"PK\x03\x04"])
def test_an_unreadable_model_costs_only_its_picture(tmp_path: Path, broken: bytes) -> None:
    recorder = new_recorder(tmp_path / "m.mcap")
    recorder.attach("model_points.npz", broken, "application/x-npz")
    recorder.scan(scan_cloud())
    recorder.estimate(estimate())
    recorder.close()
    recording = read_recording(tmp_path / "m.mcap")
    assert alignment(recording) is None
    assert "What the locator said" in render_report(recording)


def test_one_located_scan_has_a_page_of_its_own(tmp_path: Path) -> None:
    points = model_points()
    model = PortModel.from_mesh("square", *_square())
    cloud = Cloud(T_BASE_PORT.apply(points), "scanner")
    prior = Prior(T_BASE_PORT @ Pose.from_vector([0.003, 0.004, 0, 0, 0, 0]))
    found = replace(estimate(accepted=False, reasons=("too <few> points",)), ref="scanner", verdict="uncertain")
    page = Page(write_locate_report(tmp_path / "r" / "one.html", "one.ply", cloud, model, found, prior).read_text())
    for fact in (
        "Refused: uncertain",
        "one.ply · port ccs2 · 0.31 s",
        "too <few> points",
        "0.210 mm rms residual",
        "offset from the prior 5.0 mm, 0.0°",
        "time: refine 0.200 s",
        "not a safety function",
    ):
        assert fact in page.text, fact
    assert len(page.addresses) == 3, "two sides and the residuals on the model"
    assert all(address.startswith("data:image/png;base64,") for address in page.addresses)
    assert page.open == []


def test_a_scan_where_nothing_was_found_still_has_a_page(tmp_path: Path) -> None:
    nothing = replace(
        estimate(accepted=False, reasons=("no port",)),
        T_ref_port=Pose.from_vector([9.0, 0, 0, 0, 0, 0]),
        rms_residual_m=float("nan"),
        covariance=np.full((6, 6), np.inf),
        verdict="no-port",
    )
    model = PortModel.from_mesh("square", *_square())
    path = write_locate_report(tmp_path / "one.html", "one.ply", Cloud(model_points()), model, nothing, None)
    assert "unknown mm rms residual" in Page(path.read_text()).text


def _square() -> tuple[np.ndarray, np.ndarray]:
    """A plate of 60 mm with a step in it, enough for a port model: vertices (N, 3) m and faces (M, 3)."""
    corners = np.array([[-0.03, -0.03, 0], [0.03, -0.03, 0], [0.03, 0.03, 0], [-0.03, 0.03, 0]])
    raised = 0.4 * corners + [0, 0, 0.01]
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    return np.concatenate([corners, raised]), np.array(faces)
