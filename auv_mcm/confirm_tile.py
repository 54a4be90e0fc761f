"""Confirm the detections of one tile, the likeliest first, as many as its limit and its budget allow."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import islice
from typing import NamedTuple, Protocol

import msgspec

from auv_mcm.classify.odds import MineOdds
from auv_mcm.classify.verifier import NO_OPINION, Opinion
from auv_mcm.confirmation import CLOSE_LOOK_P, detector_p_mine, ended_at_verifier, without_confirmation
from auv_mcm.defects import Defect, caught
from auv_mcm.records import Detection
from auv_mcm.settings.config import ConfirmConfig
from auv_mcm.skips import NO_SKIPS, Skips

Look = Callable[[Detection, Opinion | None], Detection]
"""Confirm a detection, with the network's opinion where it is known."""


class Map(Protocol):
    """Apply a function to detections and opinions in turn, in threads or not."""

    def __call__(
        self,
        function: Callable[[Detection, Opinion | None], Detection | Defect],
        detections: Iterable[Detection],
        opinions: Iterable[Opinion | None],
        /,
    ) -> Iterable[Detection | Defect]:
        """Return the results in order."""
        ...


class ConfirmedTile(NamedTuple):
    """Hold the detections of a tile after confirmation, those on which it failed, and counters of what was done."""

    detections: list[Detection]
    defects: list[tuple[Detection, Defect]]
    counters: Counter[str]


def confirm_tile(
    detections: list[Detection],
    config: ConfirmConfig,
    odds: MineOdds,
    opinions: Callable[[list[Detection]], Iterator[Opinion | None]],
    look: Look,
    mapped: Map = map,
    without_skips: Skips = NO_SKIPS,
) -> ConfirmedTile:
    """Confirm the detections of a tile; all are returned, whatever was done to them.

    Parameters
    ----------
    opinions
        Asks the network about detections together; yields an opinion on each, then None without end.
    without_skips
        Those that are switched off.
    """
    if not config.enabled:
        bare = [msgspec.structs.replace(detection, surroundings=None) for detection in detections]
        return ConfirmedTile(bare, [], Counter())
    # Without a bound nothing is asked of the odds, so that new ones can be fitted on features that they do not know.
    takes_all = config.min_p_mine <= 0.0 or "detector-odds" in without_skips
    asking = [(d, math.inf if takes_all else detector_p_mine(d, odds)) for d in detections]
    wanted = [d for d, p_mine in asking if p_mine >= config.min_p_mine]
    best_first = sorted((d for d in wanted if d.surroundings is not None), key=lambda d: (-d.p_mine, d.row, d.column))
    unpaid = [d for d in wanted if d.surroundings is None]
    limited = "look-limit" not in without_skips
    most = config.max_per_tile if limited else len(best_first)
    chosen, rest = best_first[:most], best_first[most:]
    said = list(islice(opinions(chosen), len(chosen)))
    spared = _spared(chosen, said, odds, config) if limited and len(chosen) > config.max_examined_per_tile else {}
    asked = [(one, opinion) for k, (one, opinion) in enumerate(zip(chosen, said, strict=True)) if k not in spared]
    tried = [one for one, _ in asked]
    looks = list(
        mapped(lambda one, opinion: caught(partial(look, one, opinion)), tried, (opinion for _, opinion in asked))
    )
    defects = [(detection, done) for detection, done in zip(tried, looks, strict=True) if isinstance(done, Defect)]
    looked_at = [done for done in looks if not isinstance(done, Defect)]
    looked_at += [without_confirmation(d, p, "not_looked_at") for d, p in asking if not p >= config.min_p_mine]
    counters: Counter[str] = Counter()
    counters["confirm.beyond_budget"] += len(unpaid)
    counters["confirm.over_budget"] += len(rest) + len(spared)
    for detection in looked_at:
        found = detection.confirmation
        ended = found is None and "verifier" in detection.p_by_step
        counters["confirm.ended_at_verifier"] += ended
        counters["confirm.odds_too_low"] += found is None and not ended
        counters["confirm.looked_at"] += found is not None
        counters["confirm.rejected"] += found is not None and found.rejected
        counters["confirm.ended_at_contours"] += found is not None and "shape" not in detection.p_by_step
        counters["confirm.solids_not_refined"] += 0 if found is None else found.n_not_refined
    for reason, left in (("look_failed", [detection for detection, _ in defects]), ("over_budget", rest + unpaid)):
        looked_at += [without_confirmation(one, detector_p_mine(one, odds), reason) for one in left]
    return ConfirmedTile(looked_at + list(spared.values()), defects, counters)


def _spared(
    chosen: list[Detection], said: list[Opinion | None], odds: MineOdds, config: ConfirmConfig
) -> dict[int, Detection]:
    """End those beyond the limit of examinations with the verifier's p_mine; by their number among those chosen."""
    ended = {
        k: ended_at_verifier(one, opinion, odds, "over_budget")
        for k, (one, opinion) in enumerate(zip(chosen, said, strict=True))
        if opinion is not None and opinion is not NO_OPINION
    }
    likely = [k for k, one in ended.items() if one.p_mine >= max(config.min_p_mine, CLOSE_LOOK_P)]
    beyond = sorted(likely, key=lambda k: (-ended[k].p_mine, k))[config.max_examined_per_tile :]
    return {k: ended[k] for k in beyond}
