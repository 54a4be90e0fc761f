"""Score the payload's own calls: detections and false alarms at the operating point requested of it."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from auv_mcm.records import NAN
from auv_mcm.safe_files import read_regular
from sim_replay.scoring.inputs import ScoredMission
from sim_replay.scoring.intervals import Density, Proportion, density, proportion
from sim_replay.scoring.layout import MissionLayout, Outcome, State, lay_out, nothing_called, states

_SUMMARY = "summary.json"


class CalledPoint(msgspec.Struct, frozen=True, kw_only=True):
    """Count the contacts that the payload calls mines, all missions together.

    asked_per_km2: false alarms per km² that the operator accepted; None if it is not known, or differs between
    missions.
    """

    asked_per_km2: float | None
    pd: Proportion
    false_alarms: Density
    on_known_clutter: int


def called_point(missions: Sequence[ScoredMission], gate_m: float) -> CalledPoint | None:
    """Match the called contacts with the truth.

    None where contacts of a mission do not state whether they are called.
    """
    if not missions or any(contact.called is None for mission in missions for contact in mission.contacts):
        return None
    if not any(mission.contacts for mission in missions):
        return None
    n_found = n_targets = n_clutter = n_elsewhere = 0
    for mission in missions:
        called = mission._replace(contacts=tuple(contact for contact in mission.contacts if contact.called))
        layout = lay_out(called, gate_m)
        counts = np.bincount(last_state(layout).outcome, minlength=len(Outcome))
        n_found += int(counts[Outcome.DETECTION])
        n_clutter += int(counts[Outcome.ON_CLUTTER])
        n_elsewhere += int(counts[Outcome.ELSEWHERE])
        n_targets += int(np.count_nonzero(layout.is_target & layout.is_seen))
    asked = {mission.asked_per_km2 for mission in missions}
    known = asked.pop() if len(asked) == 1 else NAN
    return CalledPoint(
        asked_per_km2=known if math.isfinite(known) else None,
        pd=proportion(n_found, n_targets),
        false_alarms=density(n_clutter + n_elsewhere, sum(mission.truth.area_km2 for mission in missions)),
        on_known_clutter=n_clutter,
    )


def last_state(layout: MissionLayout) -> State:
    """Match all contacts, whatever their p_mine."""
    state = nothing_called(layout)
    for further in states(layout):
        state = further
    return state


def asked_beside(contacts: Path) -> float:
    """Read the density requested from the summary beside a contacts file.

    NaN where there is none, or it does not state it.
    """
    try:
        asked = json.loads(read_regular(contacts.with_name(_SUMMARY)))["operating_point"]["asked_per_km2"]
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return NAN
    return float(asked) if isinstance(asked, int | float) and not isinstance(asked, bool) else NAN
