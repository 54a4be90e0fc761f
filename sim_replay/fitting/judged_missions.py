"""Read what people judged about missions, as log-odds with verdicts, for `auv-mcm calibrate odds --verdicts`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clean_text import clean
from auv_mcm.detect.belief import odds_of
from auv_mcm.detect.cascade.choose import configured_model, fitting
from auv_mcm.errors import BadInputError
from auv_mcm.model_file import SHIPPED
from auv_mcm.program import program
from auv_mcm.records import Detector
from sim_replay.fitting.fit_background import log_odds_of
from sim_replay.verdicts import VERDICTS_FILE, is_missed, read_verdicts, sorted_verdicts
from sim_replay.view.mission_files import CONTACTS, SUMMARY, overview, read_json, read_summary, summary_config

MINE: Final = 1  # verdict of a contact: mine-like
NOT_MINE: Final = 0  # not mine-like
NOT_JUDGED: Final = -1  # by nobody, or undecided


class JudgedMission(NamedTuple):
    """Hold the contacts of one mission with what people judged.

    log_odds: (n,) of a mine, all contacts. calls: (n,) int8, MINE, NOT_MINE or NOT_JUDGED. n_missed: objects that
    people drew or judged mine-like and that no contact stands for. area_km2: searched. asked_per_km2: false alarms
    accepted. reported_from_nats: the lowest log-odds of a contact.
    """

    name: str
    detector: Detector
    log_odds: NDArray[np.float64]
    calls: NDArray[np.int8]
    n_missed: int
    area_km2: float
    asked_per_km2: float
    reported_from_nats: float

    def count(self, call: int) -> int:
        """Count the contacts of a call."""
        return int(np.count_nonzero(self.calls == call))


def read_judged_missions(folders: Sequence[Path]) -> list[JudgedMission]:
    """Read missions that people judged, each from its folder of results or session.

    Raises BadInputError for one that is not finished, not judged, named twice, or of other odds or another version.
    """
    missions: list[JudgedMission] = []
    for number, folder in enumerate(folders):
        if folder.resolve() in [other.resolve() for other in folders[:number]]:
            raise BadInputError(f"{folder} is named twice. A mission counts once.")
        missions.append(_read(folder))
    detectors = sorted({mission.detector for mission in missions})
    if len(detectors) > 1:
        raise BadInputError(
            f"some missions were replayed with the {detectors[0]}, others with the {detectors[1]}. Replay all with one "
            "detector: each has odds of its own."
        )
    return missions


def _read(folder: Path) -> JudgedMission:
    summary = read_summary(folder)
    path = folder / CONTACTS
    if summary is None or not path.is_file():
        raise BadInputError(
            f"{folder} holds no finished mission. Name a folder of results, or of a session that ended."
        )
    verdicts = read_verdicts(folder)
    if not verdicts:
        raise BadInputError(f"{folder} holds no verdicts ({VERDICTS_FILE}). Judge its contacts with 'auv-mcm view'.")
    if summary.get("program") != program():
        raise BadInputError(
            f"{folder} is of another build of version {clean(str(summary.get('version')))}. Replay it into the same "
            "folder: verdicts stay."
        )
    config = summary_config(summary, folder)
    if not config.confirm.enabled or {config.confirm.odds, config.confirm.targets} != {SHIPPED}:
        raise BadInputError(
            f"{folder} was made with confirm.enabled {str(config.confirm.enabled).lower()}, confirm.odds "
            f"{config.confirm.odds} and confirm.targets {config.confirm.targets}. Replay it with true and twice "
            f"'{SHIPPED}': verdicts change the odds that ship."
        )
    model, _ = fitting(configured_model(config), config)
    area_km2, asked_per_km2 = _searched(summary, folder)
    try:
        seen = [overview(feature) for feature in read_json(path)["features"]]
    except (KeyError, TypeError) as error:
        raise BadInputError(f"{path} holds no contacts as auv-mcm writes them. Replay the log again.") from error
    seen = [one for one in seen if math.isfinite(one.p_mine)]
    matched, alone = sorted_verdicts(verdicts, [one.place for one in seen])
    known = {"mine_like": MINE, "not_mine_like": NOT_MINE, "undecided": NOT_JUDGED}
    calls = [known[matched[one.id].call] if one.id in matched else NOT_JUDGED for one in seen]
    return JudgedMission(
        name=clean(folder.resolve().name),
        detector="contrast" if model is None else "cascade",
        log_odds=log_odds_of([one.p_mine for one in seen]),
        calls=np.array(calls, dtype=np.int8),
        n_missed=sum(map(is_missed, alone)),
        area_km2=area_km2,
        asked_per_km2=asked_per_km2,
        reported_from_nats=odds_of(config.contacts.min_p_mine),
    )


def _searched(summary: dict[str, object], folder: Path) -> tuple[float, float]:
    """Take the area and the false alarms accepted from a summary: those that contacts were called by."""
    point = summary.get("operating_point")
    values = [point.get(name) if isinstance(point, dict) else None for name in ("searched_km2", "asked_per_km2")]
    if not all(isinstance(value, int | float) and 0.0 < value < math.inf for value in values):
        raise BadInputError(
            f"{folder / SUMMARY} names no area that was searched, or no operating point. Replay the mission again."
        )
    area_km2, asked_per_km2 = values
    return float(str(area_km2)), float(str(asked_per_km2))
