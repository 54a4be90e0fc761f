"""Perception that dies or hangs is replaced, and everything comes out once, in order and the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from auv_mcm.shell.perception import MakePipeline
from tests.auv_mcm.shell import fake_pipelines as fake
from tests.auv_mcm.shell.test_service import Events, journal, mission, serve, summary


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
