"""Figures of the pages are what their command prints or has stored, wherever that takes no missions."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from auv_mcm.classify.odds import shipped_odds
from auv_mcm.clearance.residual import remaining_mines
from sim_replay.benches.every_stage.stages import every_row
from sim_replay.hil.scenario import shipped
from tests.golden.answers import Answer, read_stored, scene_names

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "auv_mcm" / "docs"
WORDS = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


class Printed(NamedTuple):
    """A page, the command that prints or stores its figures, how the page states them, and a figure per group."""

    page: str
    command: str
    states: str
    figures: Callable[[], tuple[object, ...]]


def line(name: str) -> Answer:
    answer = read_stored(f"line-{name}")
    assert answer is not None
    return answer


def highest(answer: Answer) -> float:
    return max(float(contact["p_mine"]) for contact in answer["contacts"])


def river() -> tuple[object, ...]:
    answer = line("colorado-river-455k")
    totals = answer["totals"]
    assert totals["contacts_called"] == totals["contacts_mine_like"], "both called"
    return (
        totals["contacts"],
        f"{totals['covered_km2']:.4f}",
        WORDS[totals["contacts_mine_like"]],
        f"{highest(answer):.3f}",
    )


def wreck() -> tuple[object, ...]:
    answer = line("scotsman-iver2")
    return answer["totals"]["contacts"], f"{highest(answer):.3f}", WORDS[answer["totals"]["contacts_called"]]


def mines_left() -> tuple[object, ...]:
    answers = [answer for name in scene_names() if (answer := read_stored(f"scene-{name}")) is not None]
    p_mine = [np.array([contact["p_mine"] for contact in answer["contacts"]]) for answer in answers]
    among = sum(remaining_mines(each, each >= 0.2, 1.0).expected for each in p_mine)
    seen, found = (sum(answer["totals"][name] for answer in answers) for name in ("targets_seen", "targets_found"))
    return seen, f"{among:.1f}", seen - found


def verifier() -> tuple[object, ...]:
    weights = shipped_odds("cascade").verifier
    assert weights is not None
    return f"{weights.network:.2f}", f"{weights.detector:.2f}"


GOLDEN = "python -m tests.golden"
BANK = r"bank shadows \| (\d+) contacts on ([\d.]+) km², (\w+) mine-like \(at most ([\d.]+)\)"
MARKED = r"marked by eye \| (\d+) contacts, at most ([\d.]+), (\w+) called"
LEFT = r"`python -m tests.golden`\), (\d+) targets \| ([\d.]+) \| (\d+) left"
WEIGHTS = r"evidence counts ([\d.]+) and the detector's log-odds (0\.\d+)"
TABLE = (
    Printed("results.md", GOLDEN, BANK, river),
    Printed("results.md", GOLDEN, MARKED, wreck),
    Printed("results.md", GOLDEN, LEFT, mines_left),
    Printed("results.md", "auv-mcm bench stability", r"All (\d+) rows hold", lambda: (len(every_row()),)),
    Printed("chain.md", "auv-mcm calibrate verifier", WEIGHTS, verifier),
    Printed("how-to/run-hil-in-ci.md", "auv-mcm hil --list", r"runs (\d+) scenarios", lambda: (len(shipped()),)),
)


@pytest.mark.parametrize("row", TABLE, ids=lambda row: f"{row.page} {row.states[:20]}")
def test_a_page_states_what_its_command_gives(row: Printed) -> None:
    text = " ".join((DOCS / row.page).read_text("utf-8").split())
    (found,) = re.findall(row.states, text)
    stated = (found,) if isinstance(found, str) else found
    assert stated == tuple(map(str, row.figures())), row.command


def test_the_mission_has_46_rows_and_all_that_they_name_is_there() -> None:
    page = (DOCS / "mission.md").read_text("utf-8")
    assert [int(number) for number in re.findall(r"^\| (\d+) \|", page, re.MULTILINE)] == list(range(1, 47))
    named = re.findall(r"`((?:auv_mcm|deploy|drivers|sim_replay|tests)/[\w./-]*)`", page)
    assert [name for name in named if not (ROOT / name).exists()] == []
