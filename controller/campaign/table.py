"""The campaign's result: fault x state, as Markdown and as one HTML page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from controller.campaign.findings import Findings, violations
from controller.campaign.rules import FAULTS, rule
from controller.states import State

Results = Mapping[tuple[str, str], Findings]


def verdict(fault: str, state: State, results: Results) -> tuple[str, str]:
    """(word, detail) of a cell: ok, BROKEN, impossible or not run."""
    wanted = rule(fault, state)
    if wanted.impossible:
        return "impossible", wanted.impossible
    findings = results.get((fault, state.name))
    if findings is None:
        return "not run", ""
    if broken := violations(findings, wanted):
        return "BROKEN", "; ".join(broken)
    code = f" {findings.code}" if findings.code else ""
    return "ok", f"{findings.outcome}{code}; arm {wanted.arm.value}; next start: {findings.next_start}"


def as_markdown(faults: Sequence[str], states: Sequence[State], results: Results) -> str:
    """A table of words, then the detail of every cell."""
    lines = ["# Fault campaign", "", _counts(faults, states, results), ""]
    lines += ["| fault | " + " | ".join(state.name for state in states) + " |", "|---" * (len(states) + 1) + "|"]
    for fault in faults:
        words = [verdict(fault, state, results)[0] for state in states]
        lines.append(f"| {fault} | " + " | ".join(words) + " |")
    lines += ["", "| fault | state | verdict | detail |", "|---|---|---|---|"]
    for fault in faults:
        for state in states:
            word, detail = verdict(fault, state, results)
            lines.append(f"| {fault} | {state.name} | {word} | {detail} |")
    lines += ["", *(f"- **{fault}**: {FAULTS[fault]}" for fault in faults)]
    return "\n".join(lines) + "\n"


def as_html(faults: Sequence[str], states: Sequence[State], results: Results) -> str:
    """One page without outside references; the detail of a cell is its tooltip."""
    head = "".join(f"<th>{state.name}</th>" for state in states)
    rows = []
    for fault in faults:
        cells = []
        for state in states:
            word, detail = verdict(fault, state, results)
            cells.append(f'<td class="{word.split()[0].lower()}" title="{escape(detail)}">{word}</td>')
        rows.append(f'<tr><th title="{escape(FAULTS[fault])}">{escape(fault)}</th>{"".join(cells)}</tr>')
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>Fault campaign</title><style>'
        "body{font-family:sans-serif}td,th{border:1px solid #999;padding:.3em .6em}table{border-collapse:collapse}"
        ".ok{background:#cfc}.broken{background:#f99}.impossible{color:#777}.not{background:#ffc}</style>"
        f"<h1>Fault campaign</h1><p>{escape(_counts(faults, states, results))}</p>"
        f"<table><tr><th>fault</th>{head}</tr>{''.join(rows)}</table></html>\n"
    )


def _counts(faults: Sequence[str], states: Sequence[State], results: Results) -> str:
    words = [verdict(fault, state, results)[0] for fault in faults for state in states]
    return ", ".join(f"{words.count(word)} {word}" for word in ("ok", "BROKEN", "impossible", "not run"))
