"""Keep what people judged about contacts, beside the results: append-only lines of JSON, found again by place.

Each line of `verdicts.jsonl` is one judgement of one object: who, when, where, and what it is. A later line about the
same object replaces the earlier one, which stays in the file. Contacts get other ids with every replay; a verdict
belongs to the contact nearest to its place, if one is near enough.
"""

from __future__ import annotations

import codecs
import fcntl
import logging
import math
import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Annotated, Final, Literal, NamedTuple, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta

from auv_mcm.clean_text import clean, clean_json
from auv_mcm.errors import BadInputError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import NAN, Side
from auv_mcm.safe_files import open_for_append, open_regular

log = logging.getLogger(__name__)

VERDICTS_FILE: Final = "verdicts.jsonl"
GATE_M: Final = 2.0
"""Distance in m within which a contact is the judged object whatever its error: two pings and two pixels apart, as
another configuration measures it. A contact of a greater error has a wider gate, see `gates_m`."""

Call: TypeAlias = Literal["mine_like", "not_mine_like", "undecided"]
CALLS: Final[tuple[Call, ...]] = ("mine_like", "not_mine_like", "undecided")

# What it takes to learn from verdicts, by `auv-mcm calibrate odds --verdicts`:
MIN_MISSIONS: Final = 3  # fewer leave no interval over missions
MIN_MINE_LIKE: Final = 20
"""Contacts judged mine-like, of all missions: the offset's standard error is about 0.25 nats then, half its prior."""
MIN_NOT_MINE_LIKE: Final = 40  # contacts judged not mine-like, twice as many, since most of them say little

_APART_M: Final = 5.0
"""Distance in m between two lines of one object beyond which they are about two: no gate is wider than 4 m."""

MAX_TYPE: Final = 64  # characters: a name, not a story
MAX_COMMENT: Final = 2000  # characters: a page of text
MAX_LINE_BYTES: Final = 32768
"""Bytes of a line: 2000 characters escaped as six bytes each, and the other fields. Longer ones are damage."""

_Size: TypeAlias = Annotated[float, Meta(ge=0.0, le=1000.0)] | None  # m
_Name: TypeAlias = Annotated[str, Meta(max_length=MAX_TYPE)]


class Verdict(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """Hold what one person says about one object on the sea floor, once.

    object: names the object within its file, `V0001` and on. time: ISO 8601 UTC of the judgement; by: who judged.
    contact_id, p_mine: the contact it was then, and what the chain said; empty and None for a drawn one. drawn: the
    chain had missed it. type: what it is, in the analyst's word. Sizes in m, as measured by hand. side, ground_range_m,
    view_time: where it was seen. withdrawn: earlier verdicts of this object by the same person do not count any more.
    """

    object: Annotated[str, Meta(pattern=r"^V[0-9]{4,9}$")]
    time: str
    by: _Name
    latitude_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    longitude_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    call: Call = "undecided"
    type: _Name = ""
    comment: Annotated[str, Meta(max_length=MAX_COMMENT)] = ""
    contact_id: _Name = ""
    p_mine: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None
    sigma_m: _Size = None
    drawn: bool = False
    length_m: _Size = None
    width_m: _Size = None
    height_m: _Size = None
    shadow_length_m: _Size = None
    side: Side | None = None
    ground_range_m: _Size = None
    view_time: str = ""
    withdrawn: bool = False

    def __post_init__(self) -> None:
        for name in ("by", "type", "comment", "contact_id", "view_time"):
            msgspec.structs.force_setattr(self, name, clean(getattr(self, name)))
        try:
            moment = datetime.fromisoformat(self.time)
        except ValueError as error:
            raise ValueError(f"time '{clean(self.time)}' is not ISO 8601") from error
        if moment.tzinfo is None:
            raise ValueError(f"time '{clean(self.time)}' has no time zone: write UTC as Z")


class Place(NamedTuple):
    """Hold where a contact of some results is. sigma_m: 1-sigma of its position, NaN if not known."""

    contact_id: str
    latitude_deg: float
    longitude_deg: float
    sigma_m: float = NAN


def append_verdict(folder: Path, verdict: Verdict, *, n_bytes: int | None = None) -> bool:
    """Append one verdict to the file in a folder of results, and wait until the disk holds it.

    n_bytes: of the file as it was read; where another process wrote since, nothing is appended. Returns whether it was.
    A line that was cut off before is ended first, so that it does not swallow this one. Raises OSError.
    """
    line = clean_json(msgspec.json.encode(verdict).decode()).encode() + b"\n"
    with open_for_append(folder / VERDICTS_FILE) as file:
        with suppress(OSError):  # of a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        n_now = os.fstat(file.fileno()).st_size
        if n_bytes not in (None, n_now):
            return False
        if n_now and not _ends_with_line(folder / VERDICTS_FILE):
            line = b"\n" + line
        file.write(line)
        os.fsync(file.fileno())
    return True


def read_verdicts(folder: Path) -> tuple[Verdict, ...]:
    """Read every verdict in a folder of results, in the order of judging; none if nobody judged.

    A line that was cut off, as by a power cut, is left out, and named in the log once unless it is the last, which may
    still be written. Raises BadInputError naming the line for any other damage, and for files put together in which one
    name is of two objects.
    """
    path = folder / VERDICTS_FILE
    if not path.exists():
        return ()
    try:
        with open_regular(path) as file:
            lines = file.read().removeprefix(codecs.BOM_UTF8).split(b"\n")
    except OSError as error:
        raise BadInputError(f"{path} cannot be read: {error.strerror}. Check its permissions.") from error
    verdicts: list[Verdict] = []
    last: dict[str, Verdict] = {}
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            if len(line) > MAX_LINE_BYTES:
                raise ValueError(f"it has {len(line)} bytes, more than {MAX_LINE_BYTES}")
            verdicts.append(msgspec.json.decode(line, type=Verdict))
        except (msgspec.MsgspecError, ValueError) as error:
            if _looks_cut_off(line, is_last=number == len(lines)):
                if number < len(lines):
                    _say_cut_off(path, number)
                continue
            raise BadInputError(f"{path}, line {number}: not a verdict: {error}. Mend or remove this line.") from error
        before = last.setdefault(verdicts[-1].object, verdicts[-1])
        if _apart_m(before, verdicts[-1]) > _APART_M:
            raise BadInputError(
                f"{path}, line {number}: {before.object} lies {_apart_m(before, verdicts[-1]):.0f} m from where a line "
                "before has it. Where you put two files together, give every object of the second one another name, "
                f"such as V9{before.object[1:]} for {before.object}: a name stands for one object."
            )
        last[before.object] = verdicts[-1]
    return tuple(verdicts)


def newest_verdicts(verdicts: Iterable[Verdict]) -> dict[str, Verdict]:
    """Keep the last verdict of each object, by object, without those that whoever gave them withdrew.

    Objects at the very same place, as two people judged one contact in copies of the results, are one: the last counts.
    """
    newest: dict[str, Verdict] = {}
    taken_back: set[tuple[str, str]] = set()  # objects, and by whom
    for verdict in reversed(tuple(verdicts)):
        if verdict.withdrawn:
            taken_back.add((verdict.object, verdict.by))
        elif (verdict.object, verdict.by) not in taken_back:
            newest.setdefault(verdict.object, verdict)
    by_place = {(one.latitude_deg, one.longitude_deg): one.object for one in reversed(newest.values())}
    return {name: newest[name] for name in sorted(by_place.values(), key=lambda name: _number(newest[name]))}


class Judged(NamedTuple):
    """Count the contacts of one mission that people judged.

    missed: objects that were drawn or judged mine-like and that no contact stands for; unmatched: others that none
    stands for. No odds can be learnt from either.
    """

    mine_like: int
    not_mine_like: int
    undecided: int
    missed: int = 0
    unmatched: int = 0


def count_judged(verdicts: Iterable[Verdict], places: Sequence[Place]) -> Judged:
    """Count the last verdict of each object, those of the contacts at `places` by their call."""
    matched, alone = sorted_verdicts(verdicts, places)
    calls = [verdict.call for verdict in matched.values()]
    n_missed = sum(map(is_missed, alone))
    counts = (calls.count("mine_like"), calls.count("not_mine_like"), calls.count("undecided"))
    return Judged(*counts, n_missed, len(alone) - n_missed)


def learning_words(matched: Iterable[Verdict]) -> str:
    """Say how far the verdicts of one mission's contacts are from correcting the odds, with what that takes."""
    calls = [verdict.call for verdict in matched]
    needs = f"{MIN_MINE_LIKE} mine-like and {MIN_NOT_MINE_LIKE} not, of {MIN_MISSIONS} missions, to learn from them"
    return f"judged {calls.count('mine_like')} mine-like, {calls.count('not_mine_like')} not; it takes {needs}"


def evidence_words(missions: Sequence[Judged]) -> str:
    """Say how far the verdicts of missions are from what it takes to correct the odds by them."""
    have = (
        (sum(one.mine_like + one.not_mine_like > 0 for one in missions), MIN_MISSIONS, "missions judged"),
        (sum(one.mine_like for one in missions), MIN_MINE_LIKE, "mine-like"),
        (sum(one.not_mine_like for one in missions), MIN_NOT_MINE_LIKE, "not mine-like"),
    )
    counted = ", ".join(f"{n} of {least} {what}" for n, least, what in have)
    if all(n >= least for n, least, _ in have):
        return f"enough to correct the odds by 'auv-mcm calibrate odds --verdicts': {counted}"
    return f"to correct the odds by verdicts: {counted}"


def next_object(verdicts: Iterable[Verdict]) -> str:
    """Name an object that was not judged before."""
    return f"V{1 + max(map(_number, verdicts), default=0):04d}"


def match_verdicts(verdicts: Iterable[Verdict], places: Sequence[Place]) -> dict[str, Verdict]:
    """Find the verdict of each contact, by contact id: one to one, the nearest pairs first.

    Contacts without a position, or with no verdict within their gate, are left out; so are withdrawn verdicts.
    """
    judged = list(newest_verdicts(verdicts).values())
    placed = [place for place in places if math.isfinite(place.latitude_deg) and math.isfinite(place.longitude_deg)]
    if not judged or not placed:
        return {}
    from scipy.spatial import cKDTree  # late, as its package is: half a second at the start of a page

    from sim_replay.scoring.matching import gates_m

    frame = LocalFrame(latitude_deg=judged[0].latitude_deg, longitude_deg=judged[0].longitude_deg)
    judged_m = frame.to_enu([v.latitude_deg for v in judged], [v.longitude_deg for v in judged], 0.0)
    placed_m = frame.to_enu([p.latitude_deg for p in placed], [p.longitude_deg for p in placed], 0.0)
    gate_m = gates_m(GATE_M, np.array([place.sigma_m for place in placed], dtype=np.float64))
    near = cKDTree(judged_m).query_ball_point(placed_m, gate_m)
    pairs = sorted(
        (float(np.linalg.norm(judged_m[v] - placed_m[p])), judged[v].object, placed[p].contact_id, v)
        for p, found in enumerate(near)
        for v in found
    )
    matched: dict[str, Verdict] = {}
    taken: set[str] = set()
    for _, name, contact_id, v in pairs:
        if name not in taken and contact_id not in matched:
            matched[contact_id] = judged[v]
            taken.add(name)
    return matched


def sorted_verdicts(
    verdicts: Iterable[Verdict], places: Sequence[Place]
) -> tuple[dict[str, Verdict], tuple[Verdict, ...]]:
    """Sort the newest verdicts into those of contacts, by contact id, and those that no contact stands for."""
    newest = newest_verdicts(verdicts)
    matched = match_verdicts(newest.values(), places)
    of_contacts = {verdict.object for verdict in matched.values()}
    return matched, tuple(verdict for name, verdict in newest.items() if name not in of_contacts)


def is_missed(verdict: Verdict) -> bool:
    """Decide whether a verdict that no contact stands for is of something that the chain should have found."""
    return verdict.drawn or verdict.call == "mine_like"


def _number(verdict: Verdict) -> int:
    return int(verdict.object[1:])


def _apart_m(first: Verdict, second: Verdict) -> float:
    """Measure the distance of two verdicts, to 0.5 % as long as it is short."""
    east_deg = math.remainder(second.longitude_deg - first.longitude_deg, 360.0)
    east_deg *= math.cos(math.radians(first.latitude_deg))
    return 111_320.0 * math.hypot(east_deg, second.latitude_deg - first.latitude_deg)


def _ends_with_line(path: Path) -> bool:
    with open_regular(path) as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"


@cache
def _say_cut_off(path: Path, number: int) -> None:
    log.warning("%s, line %d was cut off, as by a power cut, and is left out: judge it again", clean(str(path)), number)


def _looks_cut_off(line: bytes, *, is_last: bool) -> bool:
    """Find whether a line is the beginning of a verdict; one with its end and a comma was edited by hand."""
    return (is_last or line.startswith(b"{")) and not line.rstrip(b" \t\r,;]").endswith(b"}")
