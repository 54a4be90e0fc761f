"""Logs that hold what another one of the mission holds."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest
from msgspec import structs

from auv_mcm.records import NavSample, Notice, Ping, SourceEvent
from auv_mcm.settings.config import Config, SonarConfig
from sim_replay.logs.log_reader import Log
from sim_replay.logs.recorded import RecordedMission
from sim_replay.logs.same_log import PingsOnce
from tests.sim_replay.logs.xtf_logs import mission, written


def kept(*paths: Path, subsystem: int | None = None) -> tuple[list[str], list[str]]:
    config = Config(sonar=SonarConfig(subsystem=subsystem))  # type: ignore[arg-type]
    opened = RecordedMission(paths, config)
    return [path.name for path in opened.sizes_bytes], [notice.code for notice in opened.notices]


def one_side(side: str) -> list[NavSample | Ping]:
    return [structs.replace(event, **{side: None}) if isinstance(event, Ping) else event for event in mission(40)]


def test_a_copy_and_a_cut_copy_are_left_out(tmp_path: Path) -> None:
    whole = written(tmp_path / "a.xtf", 40)
    (tmp_path / "copy of a.xtf").write_bytes(whole.read_bytes())
    (tmp_path / "0 cut.xtf").write_bytes(whole.read_bytes()[:9000])
    names, codes = kept(tmp_path / "0 cut.xtf", whole, tmp_path / "copy of a.xtf")
    assert names == ["a.xtf"]
    assert codes == ["log_repeated"] * 2


def test_pings_that_two_files_share_count_once(tmp_path: Path) -> None:
    events = list(mission(40))
    first, second = written(tmp_path / "a.xtf", events[:50]), written(tmp_path / "b.xtf", events[30:])
    read = list(RecordedMission([first, second], Config()).events())
    times_s = [event.time_s for event in read if isinstance(event, Ping)]
    assert times_s == sorted(set(times_s))
    assert len(times_s) == 40
    assert [event.code for event in read if isinstance(event, Notice)].count("log_repeated") == 1


def test_what_was_read_before_a_reader_fails_is_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = RecordedMission([written(tmp_path / "a.xtf", 40)], Config())

    def unplugged(log: Log) -> Iterator[SourceEvent]:
        yield from islice(mission(40), 50)
        raise OSError("the disk is gone")

    monkeypatch.setattr(type(whole.logs[0]), "__iter__", unplugged)
    stream, read = whole.events(), list[SourceEvent]()
    with pytest.raises(OSError, match="the disk is gone"):
        read.extend(stream)
    assert len(read) == 50


def test_navigation_is_not_gathered_until_the_sonar_pings() -> None:
    times_s = iter(range(100))
    assert len(list(islice(PingsOnce().of(NavSample(time_s=n) for n in times_s), 3))) == 3
    assert len(list(times_s)) == 97


def test_the_same_pings_in_another_file_are_left_out(tmp_path: Path) -> None:
    names, codes = kept(written(tmp_path / "a.xtf", 40), written(tmp_path / "b.xtf", 40, port_far_to_near=False))
    assert (len(names), codes) == (1, ["log_repeated"])


def test_the_sides_in_a_file_each_and_a_second_pass_are_kept(tmp_path: Path) -> None:
    port = written(tmp_path / "p.xtf", one_side("starboard"), sides=("port",))
    starboard = written(tmp_path / "s.xtf", one_side("port"), sides=("starboard",))
    later = [structs.replace(event, time_s=event.time_s + 3600.0) for event in mission(40)]
    second = written(tmp_path / "z.xtf", later)
    names, codes = kept(port, starboard, second)
    assert (sorted(names), codes) == (["p.xtf", "s.xtf", "z.xtf"], [])


def test_of_files_of_two_frequencies_the_higher_is_used_or_the_one_configured(tmp_path: Path) -> None:
    low = written(tmp_path / "low.xtf", 40, frequency_khz=100.0)
    pings = [
        structs.replace(event, port=event.starboard, starboard=event.port) if isinstance(event, Ping) else event
        for event in mission(40)
    ]
    high = written(tmp_path / "high.xtf", pings, frequency_khz=450.0)
    assert kept(low, high) == (["high.xtf"], ["log_of_another_frequency"])
    assert kept(low, high, subsystem=20) == (["low.xtf"], ["log_of_another_frequency"])
