"""Recalibration by verdicts: against a slow maximum, what must hold whatever was judged, and contacts."""

from __future__ import annotations

import json
import math
from itertools import cycle
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, xlogy

from auv_mcm import __version__
from auv_mcm.classify.odds import configured_odds, shipped_odds
from auv_mcm.cli import main
from auv_mcm.contacts.background import (
    LEVELS_NATS,
    LOWEST_NATS,
    BackgroundPrior,
    expected_background,
    shipped_background,
)
from auv_mcm.errors import BadInputError
from auv_mcm.pipeline import Pipeline
from auv_mcm.program import program
from auv_mcm.settings.config import Config, ConfirmConfig, config_yaml, parse_config
from sim_replay.fitting.fit_background import log_odds_of
from sim_replay.fitting.fit_odds import written
from sim_replay.fitting.judged_missions import MINE, NOT_JUDGED, NOT_MINE, JudgedMission, read_judged_missions
from sim_replay.fitting.recalibrate import (
    OFFSET_SD,
    SLOPE_SD,
    Change,
    MissionLine,
    Reached,
    Refit,
    fit_change,
    map_offset_slope,
    recalibrated,
    refit,
)
from sim_replay.verdicts import Call, Verdict, append_verdict
from tests.auv_mcm.contacts.test_background import drawn_background
from tests.auv_mcm.test_pipeline_early import mission as flown_mission
from tests.make.results import write_results
from tests.sim_replay.report_samples import contact

Array = NDArray[np.float64]
PRIOR = shipped_background().cascade
REPORTED = st.lists(st.floats(LOWEST_NATS, 7.0), min_size=1, max_size=40)


def slow_maximum(log_odds: Array, is_mine: Array) -> Array:
    """Maximise the posterior, written out as probabilities, by a simplex that knows no derivatives."""

    def loss(at: Array) -> float:
        p = expit(log_odds + at[0] + at[1] * (log_odds - LOWEST_NATS))
        likelihood = float((xlogy(is_mine, p) + xlogy(1.0 - is_mine, 1.0 - p)).sum())
        return float(0.5 * (at[0] / OFFSET_SD) ** 2 + 0.5 * (at[1] / SLOPE_SD) ** 2 - likelihood)

    options = {"xatol": 1e-9, "fatol": 1e-11, "maxiter": 5000}
    return np.asarray(minimize(loss, np.zeros(2), method="Nelder-Mead", options=options).x)


def drawn(seed: int, off_nats: float = 0.0, *, n_mines: int = 25, judged: bool = True) -> JudgedMission:
    """Draw a mission whose contacts are mines less often than their log-odds say, by `off_nats`."""
    random = np.random.Generator(np.random.PCG64(seed))
    log_odds = np.concatenate([drawn_background(seed, 0.2), random.normal(1.5, 1.5, n_mines)])
    log_odds = log_odds[log_odds >= LOWEST_NATS]
    calls = np.where(random.random(len(log_odds)) < expit(log_odds - off_nats), MINE, NOT_MINE).astype(np.int8)
    if not judged:
        calls[:] = NOT_JUDGED
    return JudgedMission(f"m{seed}", "cascade", log_odds, calls, 0, 0.2, 30.0, LOWEST_NATS)


@pytest.mark.parametrize("seed", range(3))
def test_the_fit_is_the_slow_maximum(seed: int) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    log_odds = random.uniform(LOWEST_NATS, 6.0, 60)
    is_mine = (random.random(60) < expit(0.6 * log_odds - 1.0)).astype(np.float64)
    fast = map_offset_slope(log_odds, is_mine, np.ones(60))
    assert fast == pytest.approx(slow_maximum(log_odds, is_mine), abs=1e-5)


def test_no_verdicts_change_nothing_and_are_refused() -> None:
    silent = [drawn(seed, judged=False) for seed in range(3)]
    assert fit_change(silent, PRIOR) == Change()
    with pytest.raises(BadInputError, match="0 missions with contacts judged, 3 are needed; 0 contacts judged mine"):
        refit(silent, PRIOR)


@given(REPORTED)
def test_verdicts_that_agree_with_p_mine_change_nothing(found: list[float]) -> None:
    log_odds = np.array(found)
    assert map_offset_slope(log_odds, expit(log_odds), np.ones(len(log_odds))) == pytest.approx((0.0, 0.0), abs=1e-9)


@settings(max_examples=25)
@given(st.integers(0, 1000))
def test_verdicts_drawn_from_p_mine_change_it_within_their_error(seed: int) -> None:
    random = np.random.Generator(np.random.PCG64(seed))
    log_odds = random.normal(0.0, 2.0, 150).clip(LOWEST_NATS, 6.0)
    is_mine = (random.random(150) < expit(log_odds)).astype(np.float64)
    a, c = map_offset_slope(log_odds, is_mine, np.ones(150))
    # The most probable values lie within four of their own standard errors, which the priors bound.
    assert abs(a) < 4.0 * OFFSET_SD
    assert abs(c) < 4.0 * SLOPE_SD
    assert abs(a - c * LOWEST_NATS) < 1.0  # where half are mines and the verdicts say most


@given(REPORTED)
def test_false_alarms_alone_never_raise_p_mine_and_mines_alone_never_lower_it(found: list[float]) -> None:
    log_odds = np.array(found)
    levels = np.linspace(LOWEST_NATS, 9.0, 30)
    for is_mine, sign in ((0.0, -1.0), (1.0, 1.0)):
        a, c = map_offset_slope(log_odds, np.full(len(found), is_mine), np.ones(len(found)))
        assert (sign * (a + c * (levels - LOWEST_NATS)) >= 0.0).all()
        assert c > -1.0, "else what lies below the lowest level would come to lie above it"


def test_odds_that_are_too_high_are_lowered_and_a_mission_left_out_gains() -> None:
    found = refit([drawn(seed, 1.5) for seed in range(4)], PRIOR)
    assert found.refusal == ""
    assert 0.0 < found.low_nats < found.gain_nats < found.high_nats
    assert found.change.applied(np.array([1.5]))[0] < 1.5


def test_odds_that_are_right_are_left_alone() -> None:
    assert "does not exclude harm" in refit([drawn(seed) for seed in range(4)], PRIOR).refusal


def test_a_change_that_would_miss_mines_or_call_more_of_the_rest_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    missions = [drawn(seed, 1.5) for seed in range(3)]
    for after, is_refused in (
        *((Reached(4, 1, 9, 0), True), (Reached(5, 0, 13, 0), True)),
        *((Reached(5, 0, 10, 0), False), (Reached(4, 1, 8, 0), False), (Reached(6, 0, 13, 0), False)),
    ):
        counts = cycle([Reached(5, 0, 9, 0), after])
        monkeypatch.setattr("sim_replay.fitting.recalibrate.reached", lambda *_, each=counts: next(each))
        found = refit(missions, PRIOR)
        assert ("instead of 15 and 27" in found.refusal) == is_refused
        assert found.change.background_nats != 0.0, "no call goes by it"


@pytest.mark.parametrize("change", [Change(), Change(1.1, -0.8), Change(0.8, 0.3), Change(1.0, 0.0, 1.2)])
def test_the_background_moves_with_the_odds(change: Change) -> None:
    def level_nats(prior: BackgroundPrior, per_km2: float) -> float:
        return float(np.interp(-math.log(per_km2), -expected_background(prior)[0], LEVELS_NATS))

    level = level_nats(PRIOR, 30.0)
    moved = level_nats(PRIOR.recalibrated(*change), 30.0 * math.exp(change.background_nats))
    # A bin of log-odds is 0.25 nats wide, and knots do not move.
    assert moved == pytest.approx(change.offset_nats + change.slope * level, abs=0.4)


def file_of(change: Change, path: Path) -> Path:
    found = Refit(
        change,
        tuple(MissionLine(drawn(n), Reached(0, 0, 0, 0), Reached(0, 0, 0, 0), 0.1) for n in (1, 2)),
        *(0.1, 0.05, 0.15),
        "",
    )
    path.write_bytes(written(recalibrated(shipped_odds("cascade"), found, "version 0, a test")))
    return path


def naming(path: Path) -> Config:
    return Config(confirm=ConfirmConfig(odds=str(path)))


def test_the_configuration_names_the_file_which_says_where_it_comes_from(tmp_path: Path) -> None:
    path = file_of(Change(0.9, -0.5, 0.2), tmp_path / "odds.json")
    odds = configured_odds(naming(path), "cascade")
    assert odds.recalibrated is not None
    assert (odds.recalibrated.missions, odds.recalibrated.slope) == (("m1", "m2"), 0.9)
    assert "verdicts on 2 missions" in odds.fitted_on
    assert odds.prior == pytest.approx(0.9 * shipped_odds("cascade").prior - 0.5)
    with pytest.raises(BadInputError, match=r"it is for the cascade, and the contrast serves"):
        configured_odds(naming(path), "contrast")
    path.write_bytes(written(msgspec.structs.replace(odds, recalibrated=None)))
    with pytest.raises(BadInputError, match=r"it is for the detector of another version"):
        configured_odds(naming(path), "cascade")
    path.write_bytes(written(msgspec.structs.replace(odds, recalibrated=None, fitted_for="cascade")))
    with pytest.raises(BadInputError, match=r"detect.gate and contacts.background: what ships belongs to"):
        configured_odds(naming(path), "cascade")
    own = parse_config(f"detect: {{gate: none}}\ncontacts: {{background: none}}\nconfirm: {{odds: {path}}}", "own.yaml")
    assert configured_odds(own, "cascade").fitted_for == "cascade"
    assert Pipeline(own).constants["gate"] is None


def test_the_chain_gives_each_contact_the_changed_odds(tmp_path: Path) -> None:
    change = Change(0.9, -0.5, 0.2)
    confirm = ConfirmConfig(odds=str(file_of(change, tmp_path / "odds.json")))
    pipeline, unchanged = Pipeline(msgspec.structs.replace(Config(), confirm=confirm)), Pipeline(Config())
    for chain in (pipeline, unchanged):
        for event in flown_mission():
            chain.feed(event)
        chain.finish()
    # Evidence is bounded at 12 nats, which no change moves.
    plain = {one.time_s: one.p_mine for one in unchanged.contacts if 0.1 < one.p_mine < 0.999}
    now = {one.time_s: one.p_mine for one in pipeline.contacts}
    assert plain
    for time_s, p_mine in plain.items():
        expected = change.applied(log_odds_of([p_mine]))
        assert log_odds_of([now[time_s]]) == pytest.approx(expected, abs=1e-6)


def judged_results(folder: Path, n_contacts: int = 30) -> Path:
    folder.mkdir()
    places = {f"C{n:05d}": 55.0 + 0.001 * n for n in range(1, n_contacts + 1)}
    random = np.random.Generator(np.random.PCG64(n_contacts))
    p = np.round(expit(random.normal(0.0, 2.0, n_contacts)), 4)
    contacts = [contact(name, q, latitude_deg=lat) for (name, lat), q in zip(places.items(), p.tolist(), strict=True)]
    write_results(folder, contacts, [], [], "")
    for number, (contact_id, latitude) in enumerate(places.items(), 1):
        call: Call = "mine_like" if p[number - 1] > 0.9 else "not_mine_like"
        time = "2026-05-04T10:00:00Z"
        append_verdict(
            folder,
            Verdict(
                object=f"V{number:04d}",
                time=time,
                by="kim",
                latitude_deg=latitude,
                longitude_deg=12.0,
                contact_id=contact_id,
                call=call,
            ),
        )
    summary = {
        "version": __version__,
        "program": program(),
        "covered_km2": 0.35,
        "operating_point": {"asked_per_km2": 30.0, "searched_km2": 0.2},
        "config": msgspec.to_builtins(Config()),
    }
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder


def test_verdicts_find_their_contacts_and_too_few_are_refused_by_number(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [judged_results(tmp_path / name, n) for name, n in (("a", 30), ("b", 40))]
    (mission, other) = read_judged_missions(folders)
    assert (len(mission.calls), len(other.calls), mission.detector) == (30, 40, "cascade")
    assert not (mission.calls == NOT_JUDGED).any()
    assert mission.count(MINE) == np.count_nonzero(mission.log_odds > math.log(9.0))
    assert mission.area_km2 == 0.2, "overlap once, as where contacts are called"
    words = ["calibrate", "odds", "--verdicts", *map(str, folders), "--out", str(tmp_path / "odds.json")]
    assert main(words) == 3
    assert "2 missions with contacts judged, 3 are needed" in capsys.readouterr().err
    assert not (tmp_path / "odds.json").exists()


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"program": "of another checkout", "version": "0.0"}, "of another build of version 0.0"),
        ({"config": {"confirm": {"odds": "other.json"}}}, "confirm.odds other.json"),
        ({"operating_point": {"asked_per_km2": 30.0}}, "names no area"),
        ({"operating_point": 3}, "no operating point"),
    ],
)
def test_missions_that_do_not_fit_are_one_clear_line(change: dict[str, object], complaint: str, tmp_path: Path) -> None:
    folder = judged_results(tmp_path / "a", 3)
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps(summary | change))
    with pytest.raises(BadInputError, match=complaint):
        read_judged_missions([folder])
    (folder / "verdicts.jsonl").unlink()
    with pytest.raises(BadInputError, match="holds no verdicts"):
        read_judged_missions([folder])


def test_the_command_writes_a_file_that_a_configuration_loads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    missions = [drawn(seed, 1.5) for seed in range(3)]
    monkeypatch.setattr("sim_replay.fitting.judged_missions.read_judged_missions", lambda folders: missions)
    out = tmp_path / "odds.json"
    assert main(["calibrate", "odds", "--verdicts", "a", "b", "c", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "| m2 |" in said
    assert "log-loss of a verdict on missions left out: less by +" in said
    config = tmp_path / "c.yaml"
    config.write_text(config_yaml(Config(confirm=ConfirmConfig(odds=str(out)))))
    assert configured_odds(naming(out), "cascade").made_by.endswith("calibrate odds --verdicts m0 m1 m2")
    assert main(["calibrate", "odds", "--verdicts", "a", "--out", str(out)]) == 2


def test_missions_reported_from_a_higher_p_mine_show_the_same_background() -> None:
    whole = [drawn(seed) for seed in range(4)]
    from_nats = math.log(0.02 / 0.98)
    reported = [
        mission._replace(
            log_odds=mission.log_odds[mission.log_odds >= from_nats],
            calls=mission.calls[mission.log_odds >= from_nats],
            reported_from_nats=from_nats,
        )
        for mission in whole
    ]
    assert sum(len(mission.calls) for mission in reported) < 0.8 * sum(len(mission.calls) for mission in whole)
    assert fit_change(reported, PRIOR).background_nats == pytest.approx(
        fit_change(whole, PRIOR).background_nats, abs=0.1
    )
