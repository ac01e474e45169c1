"""The terminal shows the same mission in three ways, and a program's output stays clean."""

import io

import pytest
from rich.console import Console

from controller.cli.progress import LiveDisplay, MissionDisplay, PlainDisplay, make_display, time_by_state
from controller.summary import LocateSummary, MissionSummary
from tests.unit.recording_samples import summary


def console(terminal: bool) -> Console:
    return Console(file=io.StringIO(), force_terminal=terminal, width=100, color_system=None)


def text_of(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def run(display: MissionDisplay, result: MissionSummary) -> None:
    with display:
        display.note("fast: four times")
        display.state("SELF_CHECK", 0.0)
        display.state("SCANNING", 1.5)
        for k in range(101):
            display.progress("sweep", k / 100, f"{k} profiles")
        display.state("INSERTING", 4.0)
        display.progress("insertion", 0.5, "12.0 mm, 31 N")
        display.finish(result)


def test_without_a_terminal_there_are_plain_lines_and_no_escapes() -> None:
    out = console(terminal=False)
    run(make_display(console=out), summary())
    lines = text_of(out).splitlines()
    assert "\x1b" not in text_of(out)
    assert lines[0] == "fast: four times"
    assert "     1.5 s  SCANNING" in lines
    assert [line.split()[1] for line in lines if line.strip().startswith("sweep")] == ["25", "50", "75", "100"]
    assert any("12.0 mm, 31 N" in line for line in lines)
    assert "pose against truth:      0.25 mm, 0.12°" in lines
    assert "peak force:              61.5 N" in lines


def test_on_a_terminal_states_stay_and_the_table_ends_it() -> None:
    out = console(terminal=True)
    display = make_display(console=out)
    assert isinstance(display, LiveDisplay)
    run(display, summary())
    text = text_of(out)
    for expected in ("SELF_CHECK", "1.5 s", "charged", "0.25 mm, 0.12°", "61.5 N", "CHARGING 1.0 s"):
        assert expected in text
    assert text.rstrip().endswith(("╯", "┘")) or "report" in text


def test_a_live_display_gives_the_terminal_back_after_an_error() -> None:
    out = console(terminal=True)
    with pytest.raises(RuntimeError), make_display(console=out) as display:
        display.state("SELF_CHECK", 0.0)
        raise RuntimeError
    assert text_of(out).endswith("\x1b[?25h")  # the cursor is shown again


def test_quiet_prints_nothing_even_on_a_terminal() -> None:
    out = console(terminal=True)
    run(make_display(quiet=True, console=out), summary())
    assert text_of(out) == ""


def test_the_live_picture_shows_the_bar_only_while_there_is_progress() -> None:
    out = console(terminal=True)
    display = LiveDisplay(out)
    display.state("SCANNING", 0.0)
    display.progress("sweep", 0.25, "18 profiles")
    out.print(display.picture())
    assert "25 %" in text_of(out)
    display.state("LOCATING", 2.0)
    before = len(text_of(out))
    out.print(display.picture())
    assert "sweep" not in text_of(out)[before:]


def test_a_refusal_names_the_reasons_and_the_remedy() -> None:
    out = console(terminal=False)
    located = LocateSummary(False, None, None, 0.8, ("no rim found", "too few points"))
    run(
        PlainDisplay(out),
        MissionSummary("refused", "port-not-found", "Check the cover.", (("STAGING", 2.0),), 1, located),
    )
    assert "no rim found; too few points" in text_of(out)
    assert "Check the cover." in text_of(out)
    assert "pose against truth" not in text_of(out)


def test_paths_are_printed_in_one_piece(tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("a" * 60) / "mission.mcap"
    for terminal in (False, True):
        out = console(terminal)
        result = MissionSummary("charged", None, "", (), 1, recording=path)
        run(make_display(console=out), result)
        assert str(path) in text_of(out)


def test_stays_in_one_state_are_added_up() -> None:
    result = MissionSummary("charged", None, "", (("STAGING", 1.0), ("SCANNING", 2.0), ("STAGING", 0.5)), 2)
    assert time_by_state(result) == [("STAGING", 1.5), ("SCANNING", 2.0)]
