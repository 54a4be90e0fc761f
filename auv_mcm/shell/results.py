"""What a mission leaves on disk, and the running totals that go into it. Part of the shell: the stages never come here."""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
import os
import re
import stat
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, TypeVar

import numpy as np

from auv_mcm.clean_text import clean_json
from auv_mcm.clearance.area import area_state, over_area
from auv_mcm.clearance.clearance_export import BANDS, clearance_geojson
from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.clearance.residual import remaining_mines
from auv_mcm.contacts.contact import is_mine_like
from auv_mcm.contacts.export import (
    contact_order,
    contacts_csv_parts,
    contacts_geojson_parts,
    contacts_kml_parts,
    coverage_geojson_parts,
    coverage_order,
    waypoints_geojson,
)
from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame, geodetic_to_ecef
from auv_mcm.records import NAN, SEABED_TYPES, Contact, CoveragePatch, NavSample, Notice, Ping, SourceEvent, Waypoint
from auv_mcm.safe_files import open_for_append, open_regular, own_directory, replacing, sync_directory
from auv_mcm.settings.config import PlanConfig

# A longer step between two fixes or two pings is a jump, or a hole between logs: neither distance sailed nor time surveyed.
MAX_STEP_M: Final = 100.0
MAX_STEP_S: Final = 60.0

_SNIPPETS: Final = "snippets"
_SNIPPET_NAME: Final = re.compile(r"C[0-9]+\.png")
T = TypeVar("T")


class Tally:
    """Totals of everything fed to a pipeline, and the last pose known, from which a plan of further legs starts."""

    def __init__(self) -> None:
        self.pings = 0
        self.navigation_samples = 0
        self.notices = 0
        self.first_s = NAN
        self.last_s = NAN
        self.duration_s = 0.0
        self.distance_m = 0.0
        self.latitude_deg = NAN
        self.longitude_deg = NAN
        self.heading_rad = NAN
        self._course_rad = NAN
        self._ecef_m = np.full(3, np.nan)
        self._position_s = NAN

    @property
    def direction_rad(self) -> float:
        """Heading, or the course over ground where no heading was ever measured; NaN if neither is known."""
        return self.heading_rad if math.isfinite(self.heading_rad) else self._course_rad

    def add(self, event: SourceEvent) -> None:
        match event:
            case Ping():
                self.pings += 1
                self._add_time(event.time_s)
            case NavSample():
                self.navigation_samples += 1
                self._add_position(event)
            case Notice():
                self.notices += 1

    def _add_time(self, time_s: float) -> None:
        if not math.isfinite(time_s):
            return
        if math.isnan(self.first_s):
            self.first_s = time_s
        elif 0.0 < (step_s := time_s - self.last_s) <= MAX_STEP_S:
            self.duration_s += step_s
        self.last_s = time_s

    def _add_position(self, sample: NavSample) -> None:
        if math.isfinite(sample.heading_rad):
            self.heading_rad = sample.heading_rad
        if (
            not (math.isfinite(sample.latitude_deg) and math.isfinite(sample.longitude_deg))
            or sample.latitude_deg == sample.longitude_deg == 0
            or abs(sample.latitude_deg) > 90.0
            or not -180.0 <= sample.longitude_deg <= 360.0
        ):
            return
        ecef_m = geodetic_to_ecef(sample.latitude_deg, sample.longitude_deg, 0.0)
        step_m = float(np.linalg.norm(ecef_m - self._ecef_m))
        if 0.0 < step_m <= MAX_STEP_M and abs(sample.time_s - self._position_s) <= MAX_STEP_S:
            self.distance_m += step_m
            frame = LocalFrame(latitude_deg=self.latitude_deg, longitude_deg=self.longitude_deg)
            east_m, north_m, _ = frame.to_enu(sample.latitude_deg, sample.longitude_deg, 0.0)
            self._course_rad = math.atan2(east_m, north_m)
        self._ecef_m, self._position_s = ecef_m, sample.time_s
        self.latitude_deg, self.longitude_deg = sample.latitude_deg, sample.longitude_deg

    def totals(self) -> dict[str, Any]:
        return {
            "pings": self.pings,
            "navigation_samples": self.navigation_samples,
            "duration_s": round(self.duration_s, 3),
            "distance_m": round(self.distance_m, 1),
        }


def contact_totals(contacts: Iterable[Contact], coverage: Iterable[CoveragePatch]) -> dict[str, Any]:
    """Counts of contacts, and the area covered: summed over tiles, so that sea floor seen twice counts twice."""
    covered_m2 = math.fsum(patch.covered_m2 for patch in coverage)
    counted = Counter(bool(is_mine_like(contact)) for contact in contacts)
    return {"covered_km2": round(covered_m2 / 1e6, 6), "contacts": counted.total(), "contacts_mine_like": counted[True]}


def notice_lists(notices: Iterable[Notice]) -> dict[str, list[dict[str, str]]]:
    """List `notices`, which ask a person to do something, apart from `remarks`, which are for the record."""
    lists: dict[str, list[dict[str, str]]] = {"notices": [], "remarks": []}
    for notice in notices:
        told = {"code": notice.code, "text": notice.text, "place": notice.place}
        lists["remarks" if notice.for_the_record else "notices"].append(told)
    return lists


def plan_waypoints(contacts: Iterable[Contact], tally: Tally, config: PlanConfig, counters: Counter[str]) -> tuple[Waypoint, ...]:
    """The re-inspection plan from the last known pose; empty and counted if there is none."""
    from auv_mcm.plan.reinspect import plan_reinspection

    pose = (tally.latitude_deg, tally.longitude_deg, tally.direction_rad)
    if not all(map(math.isfinite, pose)):
        counters["plan.start_pose_unknown"] += 1
        return ()
    return plan_reinspection(contacts, *pose, config)


def write_results(
    folder: Path, contacts: Iterable[Contact], coverage: Iterable[CoveragePatch], waypoints: Sequence[Waypoint], mission: str
) -> None:
    """Contacts, coverage and way-points in `folder`, each file whole or not at all.

    contacts, coverage: gone through several times; one at a time where they come in the order in which they are written.
    """
    for write in result_writers(folder, contacts, coverage, waypoints, mission).values():
        write()


def result_writers(
    folder: Path, contacts: Iterable[Contact], coverage: Iterable[CoveragePatch], waypoints: Sequence[Waypoint], mission: str
) -> dict[str, Callable[[], None]]:
    """Give what writes each file of `write_results`, by the file's name; each raises OSError for itself."""
    contacts, coverage = _in_order(contacts, contact_order), _in_order(coverage, coverage_order)
    parts: dict[str, Callable[[], Iterable[bytes]]] = {
        "contacts.geojson": lambda: contacts_geojson_parts(contacts),
        "contacts.csv": lambda: (row.encode() for row in contacts_csv_parts(contacts)),
        "contacts.kml": lambda: (part.encode() for part in contacts_kml_parts(contacts, mission)),
        "coverage.geojson": lambda: coverage_geojson_parts(coverage),
        "waypoints.geojson": lambda: [waypoints_geojson(waypoints)],
    }
    return {name: partial(lambda name, of: _write_parts(folder / name, of()), name, of) for name, of in parts.items()}


def _in_order(records: Iterable[T], key: Callable[[T], Any]) -> Iterable[T]:
    """The records themselves where they come in order, so that not all of them have to be held at once."""
    return records if all(key(before) <= key(after) for before, after in pairwise(records)) else sorted(records, key=key)


def write_clearance(folder: Path, clearance: Clearance | None, picture: bytes) -> None:
    """`clearance.geojson`, and `clearance.png` where anything was searched; a picture of an earlier replay goes."""
    write_file(folder / "clearance.geojson", clearance_geojson(clearance))
    if picture:
        write_file(folder / "clearance.png", picture)
    else:
        (folder / "clearance.png").unlink(missing_ok=True)


def search_totals(clearance: Clearance | None, contacts: Iterable[Contact]) -> dict[str, Any]:
    """Sum up the search over all that was seen; empty if nothing was.

    mines_found: the sum of p_mine of contacts called mine-like. mines_left: see `remaining_mines`.
    """
    if clearance is None:
        return {}
    seen = clearance.seen
    p = clearance.p_detected[seen]
    cell_m2 = clearance.cell_m**2
    p_called: list[float] = []
    p_doubtful: list[float] = []
    for contact in contacts:
        (p_called if is_mine_like(contact) else p_doubtful).append(contact.p_mine)
    left = remaining_mines(p_doubtful, p)
    kinds = {kind: int(np.count_nonzero(clearance.seabed[seen] == index)) for index, kind in enumerate(SEABED_TYPES)}
    return {
        "searched": {
            "km2": round(p.size * cell_m2 * 1e-6, 6),
            "p_detected_mean": round(float(p.mean()), 4),
            "km2_elsewhere": round(clearance.n_elsewhere * cell_m2 * 1e-6, 6),
            "km2_at_p": {f"{low:g}": round(int(np.count_nonzero(p >= low)) * cell_m2 * 1e-6, 6) for low in BANDS[1:-1]},
            "seabed_km2": {kind: round(n_cells * cell_m2 * 1e-6, 6) for kind, n_cells in kinds.items()},
            "mines_found": round(math.fsum(p_called), 4),
            "mines_left": {
                "expected": round(left.expected, 4),
                "at_most_95": left.at_most_95,
                "p_none": round(left.p_none, 4),
                "among_contacts": len(p_doubtful),
                "p_mine_sum": round(math.fsum(p_doubtful), 4),
            },
        }
    }


def clearance_notices(clearance: Clearance | None) -> list[Notice]:
    """What a person should know about the map of clearance."""
    if clearance is None or not clearance.n_elsewhere:
        return []
    text = (
        f"{clearance.n_elsewhere * clearance.cell_m**2 * 1e-6:.3g} km² were searched too far from the rest to be in the clearance map "
        "and in the figures of the search. Check the positions in coverage.geojson; replay separate sites apart, or raise plan.cell_m."
    )
    return [Notice(code="clearance.elsewhere", text=text)]


def area_totals(clearance: Clearance | None, plan: PlanConfig, verdict: str = "") -> dict[str, Any]:
    """How the search of the area to be cleared stands at the end; empty if there is none. verdict: of planning, while it went on."""
    if not plan.area_deg:
        return {}
    state = area_state(over_area(clearance, plan.area_deg, plan.cell_m), plan.required_clearance)
    return {
        "area": {
            "km2": round(state.km2, 6),
            "required": state.required,
            "p_detected_mean": round(state.p_detected, 4),
            "percent_at_required": round(100.0 * state.share, 1),
            "reached": state.is_reached,
            "verdict": verdict,
        }
    }


def write_snippets(folder: Path, pictures: Mapping[str, bytes]) -> None:
    """Write `snippets/<id>.png` for each contact id in `pictures`; contacts' pictures of an earlier replay go, other files stay.

    Raises OSError, also for a link in the place of `snippets`.
    """
    with own_directory(folder / _SNIPPETS) as snippets:
        for contact_id, picture in pictures.items():
            _write_snippet(snippets, contact_id, picture)
        for name in os.listdir(snippets):
            if (
                _SNIPPET_NAME.fullmatch(name)
                and name.removesuffix(".png") not in pictures
                and stat.S_ISREG(os.stat(name, dir_fd=snippets, follow_symlinks=False).st_mode)
            ):
                os.unlink(name, dir_fd=snippets)


class Snippets:
    """`snippets/<id>.png`, written as pictures come; the last one of a contact stays."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder / _SNIPPETS
        self._owed: dict[str, bytes] = {}  # pictures that could not be written

    def write(self, pictures: Mapping[str, bytes] = MappingProxyType({})) -> None:
        """Raises OSError, as on a full disk; what could not be written is tried again with the next ones."""
        self._owed |= pictures
        with own_directory(self._folder) as snippets:
            for contact_id, picture in list(self._owed.items()):
                _write_snippet(snippets, contact_id, picture)
                del self._owed[contact_id]


def _write_snippet(snippets: int, contact_id: str, picture: bytes) -> None:
    """Without waiting for the disk: there are thousands."""
    with replacing(Path(f"{contact_id}.png"), directory=snippets, durable=False) as file:
        file.write(picture)


def make_results_directory(path: Path) -> Path:
    """Make the directory of a replay's results, with `snippets/` in it. Raises UsageError if one of them cannot be written to."""
    make_directory(path)
    snippets = path / _SNIPPETS
    try:
        with own_directory(snippets):
            return path
    except OSError as error:
        raise UsageError(f"{snippets} is a link or cannot be opened: {error.strerror}. Remove it, or name another directory.") from error


def write_json(path: Path, data: Any) -> None:
    """Indented JSON; NaN and infinities, which JSON lacks, become null. Control characters are escaped, so that a terminal may show it."""
    text = json.dumps(_finite(data), indent=2, ensure_ascii=False, allow_nan=False).encode("utf-8", "replace").decode()
    write_file(path, (clean_json(text) + "\n").encode())


def write_file(path: Path, data: bytes) -> None:
    """Replace `path` by `data`; a power cut leaves the old file or the new one, never a piece."""
    _write_parts(path, [data])


def _write_parts(path: Path, parts: Iterable[bytes]) -> None:
    with replacing(path) as file:
        file.writelines(parts)


def make_directory(path: Path) -> Path:
    """Make a directory if it is not there, and check that it can be written to. Raises UsageError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path).close()
    except OSError as error:
        reason = "a file is in its place" if isinstance(error, FileExistsError | NotADirectoryError) else error.strerror
        raise UsageError(f"cannot write to the output directory {path}: {reason}. Name another one.") from error
    return path


class Journal:
    """Append-only lines of JSON, on disk when `append` returns. The file is locked as long as the process lives; see `is_in_use`."""

    def __init__(self, path: Path) -> None:
        self._file = open_for_append(path)
        with contextlib.suppress(OSError):  # not every file system has locks
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._whole_bytes = self._file.seek(0, os.SEEK_END)  # the file ends in a whole line here
        self._owed = b""  # lines that a failed append could not write
        sync_directory(path.parent)

    @staticmethod
    def is_in_use(path: Path) -> bool:
        """Check whether a process that lives holds the journal at `path`. Raises OSError if there is none."""
        with open_regular(path) as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return True
            except OSError:
                return False
        return False

    def append(self, records: Iterable[Any]) -> None:
        """Raises OSError, as on a full disk; the file then ends in a whole line, and the records are written with the next ones."""
        lines = [json.dumps(_finite(record), ensure_ascii=False, allow_nan=False, separators=(",", ":")) + "\n" for record in records]
        self._owed += "".join(lines).encode("utf-8", "replace")
        self._write_owed()

    def close(self) -> None:
        """Raises OSError if lines are still owed and cannot be written."""
        try:
            self._write_owed()
        finally:
            self._file.close()

    def _write_owed(self) -> None:
        if not self._owed:
            return
        try:
            written = 0
            while written < len(self._owed):
                written += self._file.write(self._owed[written:]) or 0
            os.fsync(self._file.fileno())
        except OSError:
            with contextlib.suppress(OSError):
                self._file.truncate(self._whole_bytes)
            raise
        self._whole_bytes += len(self._owed)
        self._owed = b""


def _finite(data: Any) -> Any:
    if isinstance(data, dict):
        return {str(key): _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data
