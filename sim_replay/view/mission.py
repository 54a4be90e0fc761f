"""Gather all that the page shows of one mission, and keep what people judge about it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import msgspec
import numpy as np

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.clean_text import clean
from auv_mcm.clock import SystemClock
from auv_mcm.contacts.export import iso_time
from auv_mcm.errors import UsageError
from auv_mcm.records import Side
from auv_mcm.shell import whole_files
from sim_replay.results_folder import RESULTS_SUFFIX
from sim_replay.structures import Member, find_structures, structure_feature
from sim_replay.verdicts import (
    MAX_COMMENT,
    VERDICTS_FILE,
    Call,
    Place,
    Verdict,
    append_verdict,
    learning_words,
    match_verdicts,
    newest_verdicts,
    next_object,
    read_verdicts,
)
from sim_replay.view.background_replay import BackgroundReplay
from sim_replay.view.correction import Stretch, bottom_shown, keep_bottom
from sim_replay.view.mission_feed import MissionFeed
from sim_replay.view.mission_files import (
    ContactFile,
    Overview,
    file_stamp,
    is_silent,
    number,
    overview,
    read_json,
    read_summary,
    shown_verdict,
    time_s,
    track_of,
)
from sim_replay.view.places import Measured, SeabedPlaces, WaterfallPoint, measure_length, measure_shadow, place_points
from sim_replay.view.waterfall_store import Seen, WaterfallStore

MAX_TRACK_POINTS: Final = 8000  # of the track on the map: more than a screen has pixels
MAX_POINTS: Final = 64  # of one request to place points
NEAR_M: Final = 5.0
"""Distance in m from the chosen contact beyond which the page asks: a mine and its shadow are 8 m long at most."""
_STRIP_ROWS: Final = 64  # rows of a piece of the waterfall on the map: straight within 8 m of track

MeasuredQuantity = Literal["length", "width", "shadow"]


class Judgement(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hold what the page asks to write down.

    It is about the contact `contact_id`, the object `object`, or a new one at `row`, `across_m` of the waterfall.
    generation: of the results that the page shows, None for any.
    """

    contact_id: str = ""
    object: str = ""
    row: float | None = None
    across_m: float | None = None
    call: Call = "undecided"
    type: str = ""
    comment: str = ""
    length_m: float | None = None
    width_m: float | None = None
    height_m: float | None = None
    shadow_length_m: float | None = None
    withdrawn: bool = False
    generation: int | None = None


class ReplayAgain(NamedTuple):
    """Hold what a mission is shown from once more: its waterfall, and a replay that looks for contacts."""

    feed: MissionFeed
    replay: BackgroundReplay


class ShownMission:
    """Read one mission for the page.

    Nothing but verdicts and bottom lines is ever written, until somebody asks for another replay.
    """

    def __init__(
        self,
        folder: Path,
        feed: MissionFeed,
        *,
        by: str,
        is_live: bool,
        replay: BackgroundReplay | None = None,
        again: Callable[[], ReplayAgain] | None = None,
        later: Callable[[], MissionFeed] | None = None,
    ) -> None:
        """folder: of the results or session. by: who judges. is_live: it may still grow. replay: looks for contacts.

        again: prepares another replay into the folder, None where that is not what the folder is for. later: makes the
        waterfall once a replay that still writes the folder has ended.
        """
        self.replay = replay
        self.folder = folder
        self.feed = feed
        self.generation = 0
        """Counts replays since the page began: what was shown before is outdated, and ids may be of others."""
        self._again, self._later = again, later
        self._by, self._is_live = clean(by), is_live
        self._contacts = ContactFile(folder)
        self._overviews: list[Overview] = []
        self._overview_version = -1
        self._structures: list[dict[str, Any]] = []
        self._part_of: dict[str, str] = {}
        self._verdicts = read_verdicts(folder)
        self._verdict_version = 0
        self._verdict_stamp: tuple[int, int] | None = None
        self._matched: tuple[tuple[int, int], dict[str, Verdict]] = ((-1, -1), {})
        self.summary = read_summary(folder)

    @property
    def store(self) -> WaterfallStore:
        """Return the waterfall over ground range."""
        return self.feed.store

    def refresh(self) -> None:
        """Read what is new in the folder. Raises BadInputError for damaged files."""
        if is_other := self._contacts.refresh():
            self.generation += 1
            self.summary = None
        if (stamp := file_stamp(self.folder / VERDICTS_FILE)) != self._verdict_stamp:  # of another page, or by hand
            self._verdicts, self._verdict_stamp = read_verdicts(self.folder), stamp
            self._verdict_version += 1
        if self._overview_version != self._contacts.version:
            self._overviews = [overview(feature) for feature in self._contacts.features.values()]
            self._find_structures()
            self._overview_version = self._contacts.version
        if self.summary is None:
            self.summary = read_summary(self.folder)
        if self._later is not None and self.summary is not None and self.feed.is_done:
            self.feed.close()
            self.feed, self._later = self._later(), None
            self.feed.start()
            self.generation += not is_other

    def _find_structures(self) -> None:
        members = [
            Member(
                contact_id=one.id,
                latitude_deg=one.place.latitude_deg,
                longitude_deg=one.place.longitude_deg,
                length_m=one.length_m,
                p_mine=one.p_mine,
                called=one.called is True,
            )
            for one in self._overviews
        ]
        found = find_structures(members)
        self._part_of = {member.contact_id: one.id for one in found for member in one.members}
        self._structures = [{**one["properties"], "geometry": one["geometry"]} for one in map(structure_feature, found)]

    def state(self) -> dict[str, Any]:
        """Describe how far everything is; small, for it is asked for again and again."""
        store = self.store
        return {
            "name": clean(self.feed.config.mission or self.folder.resolve().name.removesuffix(RESULTS_SUFFIX)),
            "live": self._is_live and self.summary is None,
            "silent": self._is_live and self.summary is None and is_silent(self.folder),
            "fraction": round(self.feed.fraction_done, 4),
            "done": self.feed.is_done,
            "problem": clean(self.feed.problem),
            "pings": self.feed.n_pings,
            "row_m": store.row_spacing_m,
            "column_m": store.column_spacing_m,
            "first_row": store.first_row,
            "stop_row": store.stop_row,
            "columns": store.n_columns,
            "full": store.is_full,
            "provisional": store.is_provisional,
            "replay": None if self.replay is None else round(self.replay.fraction_done, 3),
            "replay_done": self.replay is None or self.summary is not None or bool(self.replay.problem),
            "replay_problem": "" if self.replay is None else clean(self.replay.problem),
            "contacts_version": self._contacts.version,
            "verdicts_version": self._verdict_version,
            "by": self._by,
            "mine_like_p": MINE_LIKE_P,
            "near_m": NEAR_M,
            "verdicts": len(self._verdicts),
            "judged": learning_words(self.judged().values()),
            "max_comment": MAX_COMMENT,
            "generation": self.generation,
            "replay_again": self._again is not None and self.feed.is_done and not self._is_replaying(),
        }

    def contacts(self) -> dict[str, Any]:
        """List all contacts as columns, every object that people judged, and structures that contacts are part of."""
        found = self._overviews
        rows = self.store.rows_at([contact.seen for contact in found])
        by_contact = self.judged()
        shown = {verdict.object for verdict in by_contact.values()}
        return _finite(
            {
                "version": self._contacts.version,
                "id": [contact.id for contact in found],
                "latitude": [contact.place.latitude_deg for contact in found],
                "longitude": [contact.place.longitude_deg for contact in found],
                "sigma": [contact.place.sigma_m for contact in found],
                "p": [contact.p_mine for contact in found],
                "percent": [contact.said.percent for contact in found],
                "label": [contact.said.label for contact in found],
                "called": [contact.called for contact in found],
                "time": [contact.time_s for contact in found],
                "row": rows,
                "across": [
                    -contact.ground_range_m if contact.side == "port" else contact.ground_range_m for contact in found
                ],
                "structure": [self._part_of.get(contact.id) for contact in found],
                "structures": self._structures,
                "verdicts": {name: shown_verdict(verdict) for name, verdict in by_contact.items()},
                "drawn": [
                    {**shown_verdict(verdict), "row": row} for verdict, row in zip(*self._drawn(shown), strict=True)
                ],
            }
        )

    def contact(self, name: str) -> dict[str, Any] | None:
        """Give all that the results say about a contact, None if there is none of that id."""
        feature = self._contacts.features.get(name)
        if feature is None:
            return None
        history = self.judged().get(name)
        verdicts = [] if history is None else [v for v in self._verdicts if v.object == history.object]
        place = overview(feature)
        views = feature["properties"].get("views") or []
        seen = [place.seen._replace(time_s=time_s(view.get("time")), side=str(view.get("side"))) for view in views]
        return _finite(
            {
                **feature["properties"],
                "coordinates": (feature.get("geometry") or {}).get("coordinates"),
                "depth_m": self._depth_m(place),
                "said": msgspec.structs.asdict(place.said),
                "view_rows": self.store.rows_at(seen),
                "history": [msgspec.to_builtins(verdict) for verdict in verdicts],
            }
        )

    def judged(self) -> dict[str, Verdict]:
        """Match verdicts with the contacts of these results, by id."""
        version = (self._verdict_version, self._overview_version)
        if self._matched[0] != version:
            places = [contact.place for contact in self._overviews]
            self._matched = version, match_verdicts(self._verdicts, places)
        return self._matched[1]

    def judge(self, judgement: Judgement) -> Verdict:
        """Write a verdict down, beside those of other pages.

        Raises UsageError for one about nothing or out of bounds, BadInputError for damaged ones, OSError from the disk.
        """
        if judgement.generation not in (None, self.generation):
            raise UsageError("this mission was replayed meanwhile, and its contacts have other names. Choose it again.")
        is_kept = False
        while not is_kept:
            n_bytes = (file_stamp(self.folder / VERDICTS_FILE) or (0, 0))[1]
            self._verdicts = read_verdicts(self.folder)
            self._verdict_version += 1
            try:
                verdict = self._verdict(judgement)
                verdict = msgspec.convert(msgspec.to_builtins(verdict), Verdict)  # its bounds
            except (msgspec.ValidationError, ValueError) as error:
                raise UsageError(f"this verdict cannot be kept: {error}") from error
            is_kept = append_verdict(self.folder, verdict, n_bytes=n_bytes)
        self._verdicts = (*self._verdicts, verdict)
        self._verdict_version += 1
        return verdict

    def bottom(self) -> dict[str, Any]:
        """Give the first bottom return along the waterfall, and what people corrected of it; see `bottom_shown`."""
        return _finite(bottom_shown(self.store, self.feed.recorded))

    def correct_bottom(self, stretches: Sequence[Stretch]) -> list[Path]:
        """Keep corrected first returns beside the logs; see `keep_bottom`. Raises UsageError, OSError."""
        if self.feed.recorded is None or not self.feed.is_done:
            raise UsageError(
                "the bottom line can be corrected as soon as the whole waterfall is made, and a session ended"
            )
        return keep_bottom(self.store, self.feed.recorded, self._by, stretches)

    def replay_again(self) -> None:
        """Replay the logs into the folder once more, and show that. Raises UsageError where it cannot be, OSError."""
        if self._again is None or self._is_replaying() or not self.feed.is_done:
            raise UsageError("this cannot be replayed here or now: use 'auv-mcm replay'")
        feed, replay = self._again()
        if self.replay is not None:
            self.replay.close()
        replay.start()  # while what is shown can stay, where this fails
        self.feed.close()
        self.feed, self.replay, self.summary = feed, replay, None
        self._contacts = ContactFile(self.folder)
        self._overview_version, self._matched = -1, ((-1, -1), {})
        self.generation += 1
        feed.start()

    def _is_replaying(self) -> bool:
        return self.replay is not None and self.replay.is_running

    def place(self, points: list[WaterfallPoint]) -> SeabedPlaces:
        """Place points of the waterfall on the sea floor."""
        return place_points(self.store, self.feed.config.sonar, points)

    def measure(self, quantity: MeasuredQuantity, ends: list[WaterfallPoint]) -> Measured:
        """Measure between two points of the waterfall."""
        if quantity == "shadow":
            return measure_shadow(self.store, ends)
        return measure_length(self.store, self.feed.config.sonar, ends)

    def distance_m(self, name: str, ends: list[WaterfallPoint]) -> float:
        """Measure how far the nearer of two points is from where a contact was seen, in its nearest view.

        NaN for a contact whose pings are not in the waterfall (yet), or that does not exist.
        """
        feature = self._contacts.features.get(name)
        if feature is None:
            return math.nan
        contact = overview(feature)
        seen = [(contact.time_s, contact.side, contact.ground_range_m)]
        for view in feature["properties"].get("views") or []:
            seen.append((time_s(view.get("time")), view.get("side"), number(view.get("ground_range_m"))))
        rows = np.array(
            self.store.rows_at([contact.seen._replace(time_s=when, side=str(side)) for when, side, _ in seen])
        )
        across_m = np.array([-range_m if side == "port" else range_m for _, side, range_m in seen])
        away_m = np.concatenate(
            [np.hypot((rows - end.row) * self.store.row_spacing_m, across_m - end.across_m) for end in ends]
        )
        known = away_m[np.isfinite(away_m)]
        return float(known.min()) if len(known) else math.nan

    def track(self) -> dict[str, Any]:
        """List positions along the track, NaN where it breaks, and pieces of the waterfall with their corners."""
        stop = self.store.stop_row
        if not stop and self.feed.is_done:
            return track_of(self.folder)
        every = max(1, -(-stop // MAX_TRACK_POINTS))
        rows = np.arange(0, stop, every, dtype=np.int64)
        pose, _ = self.store.poses(rows)
        lost = pose.stale | ~np.isfinite(pose.latitude_deg)
        return _finite(
            {
                "row": rows.tolist(),
                "latitude": np.where(lost, np.nan, pose.latitude_deg).round(8).tolist(),
                "longitude": np.where(lost, np.nan, pose.longitude_deg).round(8).tolist(),
                "time": pose.time_s.round(3).tolist(),
            }
        )

    def strips(self, first: int, stop: int) -> dict[str, Any]:
        """List where the waterfall lies, for the map: the outer ends of both sides, each _STRIP_ROWS rows."""
        store = self.store
        rows = np.arange(first, min(stop, store.stop_row) + 1, _STRIP_ROWS, dtype=np.float64)
        far_m = store.n_columns * store.column_spacing_m
        points = [WaterfallPoint(float(row), across) for row in rows for across in (-far_m, 0.0, far_m)]
        if not points:
            return {"row": [], "corners": []}
        places = self.place(points)
        corners = np.column_stack([places.longitude_deg, places.latitude_deg])
        corners[places.stale] = np.nan
        return _finite({"row": rows.astype(int).tolist(), "corners": corners.round(8).reshape(-1, 3, 2).tolist()})

    def layers(self) -> dict[str, Any]:
        """Give coverage, clearance and plan as the files hold them; of a session that runs, coverage as seen here."""
        found: dict[str, Any] = {}
        for name in ("coverage", "clearance", "waypoints"):
            path = self.folder / f"{name}.geojson"
            found[name] = read_json(path) if path.exists() else None
        if found["coverage"] is None:
            found["seen"] = list(self.feed.coverage)
        return found

    def _verdict(self, judgement: Judgement) -> Verdict:
        earlier = newest_verdicts(self._verdicts).get(judgement.object)
        about: dict[str, Any] = {}
        if judgement.contact_id:
            feature = self._contacts.features.get(judgement.contact_id)
            if feature is None:
                raise UsageError(f"there is no contact '{clean(judgement.contact_id)}' in these results")
            contact = overview(feature)
            earlier = self.judged().get(contact.id)
            if not math.isfinite(contact.place.latitude_deg):
                raise UsageError(f"{contact.id} has no position, so that its verdict could not be found again")
            about = _about(contact, str(feature["properties"].get("time") or ""))
        elif earlier is not None:
            about = {
                name: getattr(earlier, name)
                for name in ("latitude_deg", "longitude_deg", "sigma_m", "side", "ground_range_m", "view_time", "drawn")
            }
        elif judgement.row is not None and judgement.across_m is not None:
            about = self._drawn_at(WaterfallPoint(judgement.row, judgement.across_m))
        else:
            raise UsageError("a verdict is about a contact, an object that was judged before, or a place")
        verdict = Verdict(
            object=earlier.object if earlier else next_object(self._verdicts),
            time=iso_time(SystemClock().utc_s()) or "",
            by=self._by,
            call=judgement.call,
            type=judgement.type,
            comment=judgement.comment,
            length_m=judgement.length_m,
            width_m=judgement.width_m,
            height_m=judgement.height_m,
            shadow_length_m=judgement.shadow_length_m,
            withdrawn=judgement.withdrawn,
            **about,
        )
        if verdict.withdrawn and (earlier is None or earlier.by != verdict.by):
            why = "you did not judge this" if earlier is None else f"{earlier.by} judged this"
            raise UsageError(f"{why}: nobody withdraws what others judged. Judge it yourself: the last verdict counts.")
        if verdict.drawn and earlier is None:
            self._check_apart(verdict)
        return verdict

    def _check_apart(self, drawn: Verdict) -> None:
        """Raise UsageError for an object drawn so near to a contact that its verdict would become that contact's."""
        for name, verdict in match_verdicts((*self._verdicts, drawn), [one.place for one in self._overviews]).items():
            if verdict.object == drawn.object:
                raise UsageError(
                    f"{name} lies here and would take this verdict. If it is what you see, judge {name}; if this is "
                    f"another object beside it, judge {name} first, as undecided if need be, and draw again."
                )

    def _drawn_at(self, point: WaterfallPoint) -> dict[str, Any]:
        store = self.store
        reach_m = store.n_columns * store.column_spacing_m
        if not (store.first_row <= point.row <= store.stop_row and abs(point.across_m) <= reach_m):
            raise UsageError("this place is not in the waterfall")
        places = self.place([point])
        latitude, longitude = float(places.latitude_deg[0]), float(places.longitude_deg[0])
        if not (math.isfinite(latitude) and math.isfinite(longitude)):
            raise UsageError("this place has no position: no navigation was recorded there")
        side: Side = "port" if point.across_m < 0.0 else "starboard"
        return {
            "latitude_deg": round(latitude, 9),
            "longitude_deg": round(longitude, 9),
            "drawn": True,
            "side": side,
            "ground_range_m": round(abs(point.across_m), 3),
            "view_time": iso_time(float(places.time_s[0])) or "",
        }

    def _drawn(self, shown: set[str]) -> tuple[list[Verdict], list[float]]:
        """List objects that no contact of these results stands for, with their rows."""
        alone = [verdict for name, verdict in newest_verdicts(self._verdicts).items() if name not in shown]
        seen = [Seen(time_s(one.view_time), one.side or "", one.latitude_deg, one.longitude_deg) for one in alone]
        return alone, self.store.rows_at(seen)

    def _depth_m(self, contact: Overview) -> float:
        row = self.store.rows_at([contact.seen])[0]
        if not (math.isfinite(row) and math.isfinite(contact.ground_range_m)):
            return math.nan
        across_m = -contact.ground_range_m if contact.side == "port" else contact.ground_range_m
        return float(self.place([WaterfallPoint(row, across_m)]).depth_m[0])


def _about(contact: Overview, view_time: str) -> dict[str, Any]:
    place: Place = contact.place
    known: dict[str, Any] = {
        "sigma_m": place.sigma_m,
        "p_mine": contact.p_mine,
        "ground_range_m": contact.ground_range_m,
    }
    return {
        "latitude_deg": place.latitude_deg,
        "longitude_deg": place.longitude_deg,
        "contact_id": contact.id,
        "side": contact.side or None,
        "view_time": iso_time(contact.time_s) or view_time,
        **{name: value for name, value in known.items() if math.isfinite(value)},
    }


def _finite(found: dict[str, Any]) -> dict[str, Any]:
    """Replace NaN, which JSON lacks, by None."""
    return dict(whole_files.finite(found))
