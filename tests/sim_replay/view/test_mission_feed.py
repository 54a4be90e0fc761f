"""The waterfall of a mission: a provisional picture of its first pings, then what the chain settles on, row by row."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import cache
from itertools import takewhile

import numpy as np
import pytest
from msgspec import structs

from auv_mcm.detect.detect_tile import TileDetections
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import NavSample, Ping, SourceEvent, Tile
from auv_mcm.settings.config import Config, ConfirmConfig, DetectConfig, SonarConfig, WaterfallConfig
from sim_replay.view.mission_feed import MissionFeed, OpenedMission
from sim_replay.view.waterfall_store import WaterfallStore
from tests.sim_replay.logs import sonar_logs

ABSENT = Config(detect=DetectConfig(model="absent", gate="absent"), confirm=ConfirmConfig(odds="absent"))


@cache
def line(n_pings: int) -> tuple[NavSample | Ping, ...]:
    """The first pings of a line of 420, in order of time, with their navigation."""
    events = sonar_logs.mission(60.0)
    stop_s = [event.time_s for event in events if isinstance(event, Ping)][n_pings]
    return tuple(takewhile(lambda event: event.time_s < stop_s, events))


def fed(events: tuple[SourceEvent, ...], config: Config) -> tuple[MissionFeed, list[WaterfallStore]]:
    """Feed all events; give the waterfall that was shown after each, once there was one."""
    shown: list[WaterfallStore] = []

    def watched() -> Iterator[SourceEvent]:
        for event in events:
            yield event
            if feed.store.stop_row:
                shown.append(feed.store)
                rows.append(feed.store.stop_row)

    def opened(stop: threading.Event) -> OpenedMission:
        return OpenedMission(config, watched(), lambda: 0.0)

    rows: list[int] = []
    feed = MissionFeed(WaterfallStore(), opened)
    feed.start()
    feed.join()
    assert rows == sorted(rows)  # nothing that was shown goes again
    return feed, shown


def pictures(store: WaterfallStore) -> list[bytes]:
    return [store.picture(0, row, column).tobytes() for row in range(3) for column in range(-2, 2)]


def seen_by_the_chain(events: tuple[SourceEvent, ...]) -> WaterfallStore:
    """The rows that the chain finds mines in, with all the sea floor around them that this takes."""
    config, store = Config(waterfall=WaterfallConfig(tile_rows=64)), WaterfallStore()
    chain = Pipeline(config, detect=lambda tile: TileDetections((), 0, 0), seabed=lambda tile: None)
    for made in [*(made for event in events for made in chain.feed(event)), *chain.finish()]:
        if isinstance(made, Tile):
            store.add(made)
    return store


def test_the_first_pings_are_shown_until_the_chain_has_settled_on_as_many_rows() -> None:
    known = Config(sonar=SonarConfig(transfer="amplitude"))  # rows of the whole come without waiting for the law
    feed, shown = fed(line(290), known)
    first = shown[0]
    assert first.is_provisional
    assert pictures(first) == pictures(seen_by_the_chain(line(64)))
    assert not first.is_final(0, -1)  # where a settled one is
    assert feed.store.is_final(0, -1)
    assert not shown[-1].is_provisional
    assert pictures(feed.store) == pictures(seen_by_the_chain(line(290)))
    assert feed.store.stop_row == feed.slant.stop_row > first.stop_row


@pytest.mark.parametrize("config", [Config(), ABSENT], ids=["shipped models", "models of another computer"])
def test_a_short_line_is_shown_whole_without_any_model(config: Config) -> None:
    feed, shown = fed(line(40), config)
    assert shown == []
    assert not feed.store.is_provisional
    assert (feed.problem, feed.store.stop_row > 40) == ("", True)


def test_navigation_alone_for_long_leaves_the_first_picture_its_newest() -> None:
    events = line(70)
    first_s = events[0].time_s
    sailed = next(event for event in events if not isinstance(event, Ping))
    before = tuple(structs.replace(sailed, time_s=first_s - 0.02 * k) for k in range(4200, 0, -1))
    _, shown = fed((*before, *events), Config())
    first = shown[0]
    assert first.is_provisional
    pose, _ = first.poses(np.arange(first.stop_row))
    assert np.isfinite(pose.latitude_deg).sum() > 64
