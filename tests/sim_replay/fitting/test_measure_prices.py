"""Prices of the chain's work, measured: every one is there, and what they buy is said."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import msgspec
import pytest

from auv_mcm.budget import HYPOTHESES_PER_LOOK, look_price_us
from auv_mcm.classify.fit import Effort
from auv_mcm.cli import main
from auv_mcm.detect.cascade.model import CascadeModel
from auv_mcm.detect.detect_tile import TileDetections, detect_tile
from auv_mcm.detect.gate import Gate
from auv_mcm.errors import BadInputError
from auv_mcm.records import Tile
from auv_mcm.settings.budget_settings import BudgetConfig
from auv_mcm.settings.config import Config, ConfirmConfig, parse_config
from sim_replay.fitting import measure_prices as prices
from sim_replay.fitting.measure_prices import PriceList, hypotheses_of, price_words
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.scene_file import read_scene
from tests.sim_replay.logs.xtf_logs import written


def test_each_stage_is_priced_by_the_work_it_did(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that goes one step whenever it is read: prices are then counts of readings over counts of work."""
    ticks = itertools.count()
    monkeypatch.setattr(prices, "_LEG_M", 60.0)
    monkeypatch.setattr(prices, "_MAX_LOOKS", 5)
    monkeypatch.setattr(prices, "measure_speed", lambda *_: 5e8)
    monkeypatch.setattr("sim_replay.simulator.scene_file.read_scene", lambda name: _sparse(read_scene(name)))
    found = prices.measure_prices(Config(), lambda: 1e-3 * next(ticks), n_runs=1)
    assert found.prices.duty is None
    assert found.prices.comparison_us == pytest.approx(0.002)
    assert found.n_units["looks"] == 5
    assert found.n_units["samples"] > 0
    # Reading the clock is all that a look's steps cost: one step of the clock for solids, per look that got so far.
    assert found.prices.hypothesis_us <= 5 * 1e3 / found.n_units["hypotheses"] * 1.01
    assert all(getattr(found.prices, name) > 0.0 for name in found.prices.__struct_fields__ if name != "duty")


def test_of_several_runs_the_least_price_of_each_unit_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = iter([BudgetConfig(peak_us=900.0, field_us=5000.0), BudgetConfig(peak_us=1200.0, field_us=4000.0)])
    monkeypatch.setattr(prices, "_measured_once", lambda *_: PriceList(next(runs), {"peaks": 3}))
    found = prices.measure_prices(Config(), n_runs=2)
    assert found == PriceList(BudgetConfig(peak_us=900.0, field_us=4000.0), {"peaks": 3})


def test_on_a_log_that_shows_nothing_prices_of_looks_stay_and_others_are_measured(tmp_path: Path) -> None:
    ticks = itertools.count()
    known = BudgetConfig(peak_us=900.0, field_us=5000.0)
    log = written(tmp_path / "mission.xtf")
    found = prices.measure_prices(Config(budget=known), lambda: 1e-3 * next(ticks), n_runs=1, log=log)
    assert found.n_units["samples"] > 0
    assert found.prices.sample_us != known.sample_us
    assert (found.n_units["peaks"], found.n_units["looks"]) == (0, 0)
    assert (found.prices.peak_us, found.prices.field_us) == (known.peak_us, known.field_us)


def test_the_chain_timed_goes_by_the_odds_and_the_gate_configured(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    gates: list[Gate | None] = []

    def detect(tile: Tile, config: Config, model: CascadeModel | None, gate: Gate | None) -> TileDetections:
        gates.append(gate)
        return detect_tile(tile, config, model, gate)

    monkeypatch.setattr(prices, "_LEG_M", 60.0)
    monkeypatch.setattr(prices, "detect_tile", detect)
    ungated = parse_config("detect: {model: none, gate: none}\nconfirm: {enabled: false}", "own.yaml")
    prices.measure_prices(ungated, n_runs=1)
    assert set(gates) == {None}
    with pytest.raises(BadInputError, match=r"confirm\.odds"):
        prices.measure_prices(Config(confirm=ConfirmConfig(odds=str(tmp_path / "absent.json"))), n_runs=1)


def test_without_the_bench_the_error_says_what_measures_as_well(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "scipy", None)
    assert main(["calibrate", "budget", "--speed", "2"]) == 2
    assert "or give --log a recording of this payload" in capsys.readouterr().err


def _sparse(scene: Scene) -> Scene:
    return msgspec.structs.replace(
        scene, scatter=tuple(msgspec.structs.replace(some, count=max(1, some.count // 3)) for some in scene.scatter)
    )


def test_the_hypotheses_that_a_look_is_priced_with_are_those_of_the_search() -> None:
    assert hypotheses_of(Effort(), 0) < HYPOTHESES_PER_LOOK < hypotheses_of(Effort(), 4)


def test_what_a_duty_buys_is_said() -> None:
    words = price_words(BudgetConfig(), Config(), 2.0, 0.25)
    assert "a tile every 15.4 s; 25% of one core is 3840 ms" in words
    assert f"looks of {look_price_us(BudgetConfig()) / 1e3:.1f} ms" in words


@pytest.mark.parametrize("word", [["budget"], []])
def test_the_command_writes_a_configuration_with_prices_and_duty(
    word: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    measured = BudgetConfig(peak_us=777.0)
    monkeypatch.setattr(
        prices,
        "measure_prices",
        lambda config, log: PriceList(measured, {"looks": 2, "moves": 280, "hypotheses": 13_000}),
    )
    out = tmp_path / "calibrated.yaml"
    assert main(["calibrate", *word, "--speed", "2", "--duty", "0.2", "--write", str(out)]) == 0
    assert parse_config(out.read_text("utf-8"), "out") == Config(budget=msgspec.structs.replace(measured, duty=0.2))
    said = capsys.readouterr().out
    assert "budget.peak_us: 777" in said
    assert "a look made 140 moves and weighed 6500 hypotheses" in said
    assert main(["calibrate", *word, "--speed", "2", "--write", str(out)]) == 2  # what is there is left alone
