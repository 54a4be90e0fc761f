"""Keep first bottom returns that a person corrected beside their log, and give them to its pings.

`LOG.bottom-line.json` lies beside a log that is a file, `bottom-line.json` in the folder of a session. It names the log
by its size and by a digest of how it begins, so that it is not used for another one.
"""

from __future__ import annotations

import hashlib
import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from auv_mcm.clean_text import clean, clean_json
from auv_mcm.contacts.export import iso_time
from auv_mcm.errors import BadInputError
from auv_mcm.records import Notice, Ping, SourceEvent
from auv_mcm.safe_files import open_regular, read_regular, replacing
from sim_replay.logs.log_reader import Log
from sim_replay.logs.session_parts import session_of

BOTTOM_LINE: Final = "bottom-line.json"
MAX_POINTS: Final = 10_000
"""Points of a file: one in five seconds of 14 hours. Chosen."""
_MAX_BYTES: Final = 2 << 20  # of a file: MAX_POINTS of 100 bytes, twice
_HEAD_BYTES: Final = 1 << 20  # of a log that its digest is of: pings and their times tell logs apart
_ROUNDING_S: Final = 1e-3  # s: times are written to a millisecond


class BottomPoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Hold the slant range of the first bottom return, m, at a time, ISO 8601 UTC."""

    time: str
    first_return_m: Annotated[float, Meta(gt=0.0, le=1000.0)]

    @property
    def time_s(self) -> float:
        """Give the time as UTC seconds since 1970. Raises ValueError."""
        moment = datetime.fromisoformat(self.time)
        if moment.tzinfo is None:
            raise ValueError(f"time '{clean(self.time)}' has no time zone: write UTC as Z")
        return moment.timestamp()


class LogIdentity(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Hold what a log is known by: its name for people, its bytes, and the SHA-256 of its first MiB."""

    name: str
    bytes: int
    head_sha256: str


class BottomLine(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hold the first returns of one log that a person corrected.

    by, time: who and when, ISO 8601 UTC. stretches: each of two points or more in order of time; between them the first
    return changes linearly, and outside of stretches it is tracked.
    """

    version: Literal[1] = 1
    log: LogIdentity
    by: Annotated[str, Meta(max_length=64)] = ""
    time: str = ""
    stretches: tuple[tuple[BottomPoint, ...], ...] = ()

    def __post_init__(self) -> None:
        if sum(map(len, self.stretches)) > MAX_POINTS:
            raise ValueError(f"it has more than {MAX_POINTS} points")
        if any(len(stretch) < 2 for stretch in self.stretches):
            raise ValueError("a stretch has fewer than two points")
        times_s = [point.time_s for stretch in self.stretches for point in stretch]
        if any(not later > earlier for earlier, later in pairwise(times_s)):
            raise ValueError("points are not in order of time, or stretches overlap")


class FoundLine(NamedTuple):
    """Hold the file beside a log. sha256: of the file. line: None where it cannot be used, for which problem says why.

    path: of the file, absolute.
    """

    path: Path
    sha256: str
    line: BottomLine | None
    problem: str = ""

    def entry(self) -> dict[str, Any]:
        """Give what `summary.json` says of it."""
        used = {} if self.line is None else {"by": self.line.by, "stretches": len(self.line.stretches)}
        return {"path": clean(str(self.path)), "sha256": self.sha256, "used": self.line is not None, **used}


def bottom_line_path(log: Path) -> Path:
    """Name the file that a log's corrections are kept in."""
    if log.is_dir():
        return session_of(log).resolve() / BOTTOM_LINE
    return log.absolute().with_name(f"{log.name}.{BOTTOM_LINE}")


def identity(log: Log) -> LogIdentity:
    """Describe a log so that it is known again. Raises OSError, BadInputError."""
    sizes = log.sizes_bytes
    first = next(iter(sizes))
    with open_regular(first) as file:
        head_sha256 = hashlib.sha256(file.read(_HEAD_BYTES)).hexdigest()
    return LogIdentity(name=clean(first.name), bytes=sum(sizes.values()), head_sha256=head_sha256)


def find_bottom_line(path: Path, log: Log) -> FoundLine | None:
    """Read the corrections beside a log; None if there are none.

    Parameters
    ----------
    path
        Of the log, as it was named.
    log
        The same, opened.
    """
    place = bottom_line_path(path)
    if not place.exists():
        return None
    try:
        data = read_regular(place, _MAX_BYTES)
    except (OSError, BadInputError) as error:
        return FoundLine(place, "", None, f"{place} cannot be read: {error}")
    digest = hashlib.sha256(data).hexdigest()
    try:
        line = msgspec.json.decode(data, type=BottomLine)
    except (msgspec.MsgspecError, ValueError) as error:
        return FoundLine(place, digest, None, f"{place} is not a corrected bottom line: {error}. Mend or remove it")
    found = identity(log)
    if (line.log.bytes, line.log.head_sha256) != (found.bytes, found.head_sha256):
        made_for = f"'{clean(line.log.name)}' of {line.log.bytes} bytes"
        text = f"{place} was made for another log, {made_for}. Remove it, or correct the line again"
        return FoundLine(place, digest, None, text)
    return FoundLine(place, digest, line)


def write_bottom_line(log: Path, line: BottomLine) -> Path:
    """Write the corrections of a log beside it, or remove the file where none are left; returns its path.

    Raises OSError.

    Parameters
    ----------
    log
        As it was named.
    line
        Replaces what is there.
    """
    place = bottom_line_path(log)
    if not line.stretches:
        place.unlink(missing_ok=True)
        return place
    text = msgspec.json.format(msgspec.json.encode(line), indent=1).decode()
    with replacing(place) as file:
        file.write(clean_json(text).encode() + b"\n")
    return place


def corrected(events: Iterable[SourceEvent], found: FoundLine) -> Iterator[SourceEvent]:
    """Give pings within stretches their corrected first return; a notice ends them where a stretch met no ping.

    Parameters
    ----------
    events
        Of the log.
    found
        What lies beside it, usable.
    """
    assert found.line is not None
    stretches = found.line.stretches
    times_s = [[point.time_s for point in stretch] for stretch in stretches]
    returns_m = [[point.first_return_m for point in stretch] for stretch in stretches]
    starts_s = [times[0] - _ROUNDING_S for times in times_s]
    n_pings = [0] * len(stretches)
    for event in events:
        if isinstance(event, Ping) and math.isfinite(event.time_s):
            number = bisect_right(starts_s, event.time_s) - 1
            if number >= 0 and event.time_s <= times_s[number][-1] + _ROUNDING_S:
                n_pings[number] += 1
                return_m = float(np.interp(event.time_s, times_s[number], returns_m[number]))
                event = msgspec.structs.replace(event, first_return_m=return_m)
        yield event
    empty = [stretch for stretch, n in zip(stretches, n_pings, strict=True) if not n]
    if empty:
        text = (
            f"{len(empty)} of {len(stretches)} stretches in {found.path} hold no ping of their log, the first from "
            f"{clean(empty[0][0].time)}: they change nothing. Correct the bottom line again, or remove them"
        )
        yield unused_notice(found.path, text)


def unused_notice(path: Path, text: str) -> Notice:
    """Say that a corrected bottom line, or a part of it, is not used."""
    return Notice(code="bottom_line_unused", text=f"bottom line not used: {text}.", place=clean(str(path)))


def line_of(log: Log, by: str, time_s: float, stretches: Sequence[Sequence[tuple[float, float]]]) -> BottomLine:
    """Make the corrections of a log from times, UTC seconds, and first returns, m.

    Parameters
    ----------
    by, time_s
        Who corrected, and when.
    stretches
        Each of two points or more.

    Raises
    ------
    ValueError
        For points out of order or out of bounds.
    """
    parts = tuple(
        tuple(BottomPoint(iso_time(when_s) or "", round(return_m, 3)) for when_s, return_m in sorted(stretch))
        for stretch in sorted(stretches, key=min)
    )
    line = BottomLine(log=identity(log), by=clean(by)[:64], time=iso_time(time_s) or "", stretches=parts)
    return msgspec.convert(msgspec.to_builtins(line), BottomLine)  # its bounds


def lines_beside(logs: Iterable[Path]) -> set[tuple[str, str]]:
    """Find the corrections that lie beside files of logs now: paths and digests."""
    places: set[Path] = set()
    for log in logs:
        places.add(bottom_line_path(log))
        if log.suffix == ".mcap":  # of a recording, in a session
            places |= {folder / BOTTOM_LINE for folder in log.resolve().parents[:2]}
    found = set()
    for place in places:
        try:
            found.add((clean(str(place)), hashlib.sha256(read_regular(place, _MAX_BYTES)).hexdigest()))
        except FileNotFoundError:
            continue
        except (OSError, BadInputError):
            found.add((clean(str(place)), ""))
    return found
