"""What recorded logs are taken for, and what follows from it.

The makers document none of these laws; the README of the data says why.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Notice, Ping, TransferKind
from auv_mcm.settings.config import Config, SonarConfig
from auv_mcm.waterfall.law_watch import LawVerdict, LawWatch
from sim_replay.logs.xtf import XtfLog

SharedData = Callable[[str], Path]

REEF = "floors/barbados-reef-450k-dev.xtf"
RIVER = "sidescan/colorado-river-455k.xtf"
WRECK = "sidescan/scotsman-iver2.xtf"
LAWS: dict[str, TransferKind] = {REEF: "log", RIVER: "log", WRECK: "amplitude"}
REEF_DB_PER_COUNT = 80.0 / 255.0  # the limits that its records carry
RIVER_DB_PER_COUNT = 0.35  # about


@cache
def pings_of(path: Path) -> tuple[Ping, ...]:
    return tuple(event for event in XtfLog(path, SonarConfig()) if isinstance(event, Ping))


def verdicts(sonar: SonarConfig, pings: tuple[Ping, ...]) -> list[LawVerdict]:
    watch = LawWatch(sonar)
    found = [verdict for ping in pings if (verdict := watch.add(ping)) is not None]
    last = watch.finish()
    return found if last is None else [*found, last]


@pytest.mark.parametrize("name", LAWS)
def test_the_law_is_found_and_does_not_turn(shared_data: SharedData, name: str) -> None:
    (verdict,) = verdicts(SonarConfig(), pings_of(shared_data(name)))
    assert verdict.transfer is not None
    assert verdict.transfer.kind == LAWS[name]
    assert [notice.code for notice in verdict.notices] == ["transfer.chosen"]


@pytest.mark.parametrize("name", LAWS)
def test_the_law_is_found_wherever_the_recording_starts(shared_data: SharedData, name: str) -> None:
    pings = pings_of(shared_data(name))
    for start in range(0, max(len(pings) - 256, 1), 200):
        first = verdicts(SonarConfig(), pings[start:])[0]
        assert first.transfer is not None
        assert first.transfer.kind == LAWS[name], start


@pytest.mark.parametrize("name", [REEF, RIVER])
def test_averaged_looks_are_not_taken_for_decibels(shared_data: SharedData, name: str) -> None:
    """Single-look speckle would make them 0.61 from ping 800 of the reef on, 0.44 from ping 1200 of the river.

    Too few decibels cost little, too many cost detections.
    """
    true = REEF_DB_PER_COUNT if name == REEF else RIVER_DB_PER_COUNT
    transfer = verdicts(SonarConfig(), pings_of(shared_data(name)))[0].transfer
    assert transfer is not None
    assert 0.6 * true < transfer.db_per_count < 1.15 * true


@pytest.mark.parametrize(
    ("name", "sonar"),
    [
        (REEF, SonarConfig(transfer="log", db_per_count=REEF_DB_PER_COUNT)),
        (REEF, SonarConfig(transfer="log")),
        (RIVER, SonarConfig(transfer="log", db_per_count=RIVER_DB_PER_COUNT)),
        (RIVER, SonarConfig(transfer="log")),
        (WRECK, SonarConfig(transfer="amplitude")),
    ],
)
def test_a_recorder_configured_rightly_is_never_doubted(shared_data: SharedData, name: str, sonar: SonarConfig) -> None:
    pings = pings_of(shared_data(name))
    for start in (0, 100, 200):
        assert not [notice.code for verdict in verdicts(sonar, pings[start:]) for notice in verdict.notices]


@pytest.mark.parametrize(
    ("name", "wrong"), [(REEF, "amplitude"), (REEF, "intensity"), (RIVER, "amplitude"), (WRECK, "log")]
)
def test_a_recorder_configured_wrongly_is_doubted(shared_data: SharedData, name: str, wrong: TransferKind) -> None:
    codes = [
        notice.code for v in verdicts(SonarConfig(transfer=wrong), pings_of(shared_data(name))) for notice in v.notices
    ]
    assert codes == ["transfer.disagrees"]


def test_the_bottom_of_the_reef_is_tracked_without_a_configured_law(shared_data: SharedData) -> None:
    """Taken for amplitudes, 768 of its 1500 pings have no bottom that can be seen."""
    lost = []
    for sonar in (SonarConfig(), SonarConfig(transfer="log", db_per_count=REEF_DB_PER_COUNT)):
        pipeline = Pipeline(Config(sonar=sonar))
        events = [
            event for given in XtfLog(shared_data(REEF), sonar) for event in pipeline.feed(given)
        ] + pipeline.finish()
        lost.append(pipeline.counters["bottom.not_seen"])
        assert not any(isinstance(event, Notice) and event.code == "transfer.disagrees" for event in events)
    assert lost[0] <= lost[1] + 15
