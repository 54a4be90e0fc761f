"""Perception that dies or hangs is replaced, and everything comes out once, in order and the same."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import pytest

from auv_mcm.records import SourceEvent
from auv_mcm.shell.perception import MakePipeline
from auv_mcm.source import EventSink
from tests.auv_mcm.shell import fake_pipelines as fake
from tests.auv_mcm.shell.service_runs import Events, journal, mission, serve, summary


@pytest.mark.parametrize("make", [fake.DyingOnce, fake.HangingOnce, fake.DyingAtItsEndOnce])
def test_a_mission_whose_perception_ends_on_the_way_gives_the_same_as_one_undisturbed(
    make: MakePipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAILED_ONCE", str(tmp_path / "failed"))
    said: dict[str, list[str]] = {"undisturbed": [], "disturbed": []}
    results = {
        name: serve(tmp_path / name, Events(mission(30)), pipeline, console=said[name].append)
        for name, pipeline in (("undisturbed", fake.Base), ("disturbed", make))
    }
    assert said["disturbed"] == said["undisturbed"]
    assert journal(results["disturbed"]) == journal(results["undisturbed"])
    for file in ("contacts.geojson", "coverage.geojson"):
        assert (results["disturbed"] / file).read_bytes() == (results["undisturbed"] / file).read_bytes()
    totals = summary(results["disturbed"])
    assert totals["counters"].pop("perception.restarted") == 1
    assert totals["counters"] == summary(results["undisturbed"])["counters"]
    assert totals["pings"] == 30
    assert not (results["disturbed"] / "state").exists()


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
