"""Every skip of the chain is registered, counted, can be switched off, and does what its proof says."""

from __future__ import annotations

import json
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Final, get_args

import numpy as np
import pytest

from auv_mcm.cli import main
from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact
from auv_mcm.settings.budget_settings import BudgetConfig
from auv_mcm.settings.config import Config, ConfirmConfig, ContactsConfig, DetectConfig, WaterfallConfig
from auv_mcm.skips import ALL_SKIPS, NO_SKIPS, SKIPS, Skip, SkipName, Skips
from tests.auv_mcm.test_pipeline_properties import mission
from tests.sim_replay.logs.xtf_logs import written

TIGHT: Final[dict[SkipName, Config]] = {
    "empty-tiles": Config(waterfall=WaterfallConfig(tile_rows=64, max_ping_gap_m=0.05)),
    "cascade-budget": Config(budget=BudgetConfig(duty=1e-4)),
    "candidate-limit": Config(detect=DetectConfig(max_candidates_per_tile=2)),
    "detector-odds": Config(contacts=ContactsConfig(min_p_mine=0.0)),
    "look-limit": Config(confirm=ConfirmConfig(max_per_tile=0)),
    "look-budget": Config(budget=BudgetConfig(duty=1e-4)),
    "gate": Config(contacts=ContactsConfig(min_p_mine=0.1)),
    "verifier-odds": Config(contacts=ContactsConfig(min_p_mine=0.0)),
    "contour-odds": Config(
        detect=DetectConfig(model="none"),
        contacts=ContactsConfig(min_p_mine=0.0),
        confirm=ConfirmConfig(min_p_mine=0.002),
    ),
}
"""Configurations under which a skip leaves something out of the short mission, where the default leaves out nothing."""


@cache
def outcome(name: SkipName | None, without: Skips) -> tuple[Counter[str], tuple[Contact, ...]]:
    """Counters and contacts of the short mission under the configuration for a skip, the default for None."""
    pipeline = Pipeline(Config() if name is None else TIGHT.get(name, Config()), without_skips=without)
    for event in mission():
        pipeline.feed(event)
    pipeline.finish()
    return pipeline.counters, pipeline.contacts


def test_every_name_is_registered_once_with_a_counter_of_its_own() -> None:
    assert [skip.name for skip in SKIPS] == list(get_args(SkipName))
    assert len({skip.counter for skip in SKIPS}) == len(SKIPS)


@pytest.mark.parametrize("skip", SKIPS, ids=lambda skip: skip.name)
def test_a_skip_counts_what_it_leaves_out_and_nothing_once_it_is_off(skip: Skip) -> None:
    counters, _ = outcome(skip.name, NO_SKIPS)
    assert counters[skip.counter] > 0
    without, _ = outcome(skip.name, frozenset({skip.name}))
    assert without[skip.counter] == 0


@pytest.mark.parametrize("skip", [skip for skip in SKIPS if skip.proof == "bytes"], ids=lambda skip: skip.name)
def test_a_skip_proven_by_bytes_changes_none(skip: Skip) -> None:
    _, contacts = outcome(skip.name, NO_SKIPS)
    _, without = outcome(skip.name, frozenset({skip.name}))
    assert contacts_geojson(without) == contacts_geojson(contacts)


@pytest.mark.parametrize("skip", [skip for skip in SKIPS if skip.proof == "bytes while 0"], ids=lambda skip: skip.name)
def test_a_limit_that_is_not_reached_changes_no_byte(skip: Skip) -> None:
    counters, contacts = outcome(None, NO_SKIPS)
    assert counters[skip.counter] == 0
    _, without = outcome(None, frozenset({skip.name}))
    assert contacts_geojson(without) == contacts_geojson(contacts)


def test_without_any_skip_nothing_is_counted_as_left_out_and_what_was_called_stays() -> None:
    counters, contacts = outcome(None, ALL_SKIPS)
    assert {skip.name: counters[skip.counter] for skip in SKIPS if counters[skip.counter]} == {}
    called = [contact for contact in outcome(None, NO_SKIPS)[1] if contact.p_mine >= 0.2]
    assert called
    for contact in called:
        near = [
            c
            for c in contacts
            if np.hypot(c.views[0].row - contact.views[0].row, c.views[0].column - contact.views[0].column) < 10
        ]
        assert max(c.p_mine for c in near) >= 0.2


def test_replay_switches_skips_off_by_name_and_says_so(tmp_path: Path) -> None:
    log = written(tmp_path / "log.xtf", 150)
    assert (
        main(
            [
                "replay",
                str(log),
                "--out",
                str(tmp_path / "a"),
                "--without-skip",
                "gate",
                "--without-skip",
                "contour-odds",
            ]
        )
        == 0
    )
    summary = json.loads((tmp_path / "a" / "summary.json").read_bytes())
    assert (summary["without_skips"], summary["exhaustive"]) == (["contour-odds", "gate"], False)
    assert main(["replay", str(log), "--out", str(tmp_path / "b"), "--exhaustive"]) == 0
    assert json.loads((tmp_path / "b" / "summary.json").read_bytes())["exhaustive"] is True


def test_a_skip_that_is_not_there_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["replay", "log.xtf", "--out", str(tmp_path), "--without-skip", "luck"])
    assert ended.value.code == 2
    assert "luck" in capsys.readouterr().err


def test_the_documentation_has_every_skip_with_its_counter() -> None:
    text = (Path(__file__).parents[2] / "auv_mcm" / "docs" / "chain.md").read_text("utf-8")
    for skip in SKIPS:
        assert f"| `{skip.name}` | {skip.leaves_out} | {skip.because} | `{skip.counter}` |" in text
