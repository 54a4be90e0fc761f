"""Perception that dies or hangs is replaced, and everything comes out once, in order and the same."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from auv_mcm.records import SourceEvent
from auv_mcm.shell.event_spool import EventSpool, Spooled, read_events
from auv_mcm.shell.perception_chain import MakePipeline
from auv_mcm.source import EventSink
from tests.auv_mcm.shell import fake_pipelines as fake
from tests.auv_mcm.shell.service_runs import Events, journal, mission, serve, summary
from tests.make.disks import full

Served = tuple[Path, list[str]]
"""The folder of a session, and what was said on the way."""


def served(folder: Path, make: MakePipeline) -> Served:
    said: list[str] = []
    return serve(folder, Events(mission(30)), make, console=said.append), said


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Served:
    return served(tmp_path_factory.mktemp("undisturbed"), fake.Base)


@pytest.mark.parametrize(
    ("make", "n_restarts"),
    [
        (fake.DyingOnce, 1),
        (fake.DyingOnceAndOnceAtItsStart, 2),
        (fake.HangingOnce, 1),
        (fake.HangingWhileItAnswersOnce, 1),
        (fake.HangingAtItsStartOnce, 1),
        (fake.DyingAtItsEndOnce, 1),
    ],
)
def test_a_mission_whose_perception_ends_on_the_way_gives_the_same_as_one_undisturbed(
    make: MakePipeline, n_restarts: int, undisturbed: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAILED_ONCE", str(tmp_path / "failed"))
    monkeypatch.setattr("auv_mcm.shell.lasting_perception._IDLE_AT_START_S", 1.0)
    (results, said), (expected, expected_said) = served(tmp_path / "disturbed", make), undisturbed
    assert said == expected_said
    assert journal(results) == journal(expected)
    for file in ("contacts.geojson", "coverage.geojson"):
        assert (results / file).read_bytes() == (expected / file).read_bytes()
    totals = summary(results)
    assert totals["counters"].pop("perception.restarted") == n_restarts
    assert totals["counters"] == summary(expected)["counters"]
    assert totals["pings"] == 30
    assert not (results / "state").exists()


def test_contacts_after_events_that_the_disk_did_not_take_have_numbers_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAILED_ONCE", str(tmp_path / "failed"))
    monkeypatch.setattr("auv_mcm.shell.event_spool.open_new", full)
    results = serve(tmp_path / "out", Events(mission(30)), fake.DyingOnce)
    assert summary(results)["counters"]["fake.reserved"] == 3


class Paced(Events):
    """Gives a few events, and once perception has failed the others, over more time than a process takes to start."""

    n_given = 0

    async def _give(self, event: SourceEvent, sink: EventSink) -> None:
        await super()._give(event, sink)
        self.n_given += 1
        while self.n_given > 12 and not Path(os.environ["FAILED_ONCE"]).exists():
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.002)


def test_pings_that_come_while_perception_is_replaced_count_as_waiting_so_that_work_is_shed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAILED_ONCE", str(tmp_path / "failed"))
    results = serve(tmp_path / "out", Paced(mission(300), lossless=False), fake.DyingOnce, queue_pings=100)
    counters = summary(results)["counters"]
    assert counters["perception.restarted"] == 1
    assert counters["ping.received"] + counters.get("service.ping_dropped", 0) == 300
    assert counters["service.work_shed"] > 0


class SlowlyRead(Events):
    """Gives a few events, once perception has failed some whenever the spool is read, and at last the others."""

    n_at_once = 3
    n_given = n_wanted = n_reads = 0
    patience = 200  # looks at whether it is read again

    async def _give(self, event: SourceEvent, sink: EventSink) -> None:
        await super()._give(event, sink)
        self.n_given += 1
        while self.n_given >= 12 and self.n_given >= self.n_wanted and self.patience:
            await asyncio.sleep(0.01)
            self.patience -= self.n_reads > 0

    def read(self, spool: EventSpool, after: int, until: int) -> Iterator[Spooled]:
        self.n_reads += 1
        self.n_wanted = self.n_given + self.n_at_once
        while self.n_given < min(self.n_wanted, len(self._events)):
            time.sleep(0.001)
        yield from read_events(spool._folder, after, until)


@pytest.mark.parametrize("n_samples", [3, 2400], ids=["few", "two seconds of an inertial unit"])
def test_perception_that_was_replaced_catches_up_though_events_come_whenever_the_disk_is_read(
    n_samples: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    samples = [fake.navigation(number) for number in range(50, 50 + 4 * n_samples)]
    source = SlowlyRead([*mission(50), *samples, *mission(50)], lossless=False)
    source.n_at_once = n_samples
    monkeypatch.setattr(EventSpool, "read", lambda spool, after, until: source.read(spool, after, until))
    monkeypatch.setenv("FAILED_ONCE", str(tmp_path / "failed"))
    results = serve(tmp_path / "out", source, fake.DyingOnce)
    counters = summary(results)["counters"]
    assert (counters["perception.restarted"], counters["ping.received"]) == (1, 100)
    assert source.n_reads <= 3
