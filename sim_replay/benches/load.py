"""Load the chain with the worst that it may be fed: floors that make tiles expensive, and 100,000 contacts.

auv-mcm bench load [--pings N] [--contacts N] [--quick] [--markdown]

Drawn floors go through the whole chain, ping by ping: what a ping costs in the median, at 99.9 % and at most, which is
the ping that completes the worst tile, and whether the mission's budget bounds it. Then a ledger on disk takes
detections until it holds so many contacts, and all results are written. Times are of the processor, and nothing is
judged by them; `--quick` takes little of everything. The exit code is 5 if a contact is
lost on its way to the results.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.contact_store import ContactStore
from auv_mcm.contacts.ledger import Ledger
from auv_mcm.contacts.record_file import RecordFile
from auv_mcm.errors import SelfCheckError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, Detection, EchoTrace, NavSample, Notice, Ping, SourceEvent, contact_number
from auv_mcm.settings.budget_settings import BudgetConfig
from auv_mcm.settings.config import Config
from auv_mcm.shell.results import write_results
from auv_mcm.snippet import pack_snippet
from sim_replay.arguments import count
from sim_replay.text_tables import columns, markdown

Plane = NDArray[np.float64]

N_PINGS: Final = 4096
"""Pings of a floor: 290 m of track."""
N_CONTACTS: Final = 100_000
"""Contacts of a mission: 50 km² of the 2000 per km² that crowded sea floor gives."""
_QUICK_PINGS, _QUICK_CONTACTS = 768, 1000
_DUTY: Final = 0.05  # of one core: the budget that is tried beside none; more than that bounds no tile drawn here

_RANGE_M, _N_SAMPLES, _ALTITUDE_M, _DEPTH_M = 50.0, 1024, 5.0, 15.0
_PING_RATE_HZ, _SPEED_MPS = 14.0, 2.0
_START_S: Final = 1_780_000_000.0  # UTC seconds since 1970
_HOME: Final = LocalFrame(latitude_deg=54.1, longitude_deg=10.2)
_WATER: Final = 1e-3  # intensity in the water column over that of the floor: -30 dB
_FULL_SCALE: Final = 32767.0  # counts, of 15 bits
_COUNTS: Final = 1000.0  # amplitude of the floor, in counts of a recorder

_PER_KM2: Final = 2000.0  # contacts: what a crowded sea floor gives
_AT_ONCE: Final = 8  # detections that a tile settles
_APART_S: Final = 120.0  # s from tile to tile, so that none is of the passage before
_STEPS: Final = 5  # sizes of the ledger that a row is printed for, a factor of ten apart
_MEASURED: Final = 1000  # detections about each size whose cost is measured
_KINDS: Final = ("geojson", "csv", "kml")  # of results that hold contacts
_BYTES_PER_MB: Final = 1e6  # bytes per megabyte


class FloorCost(NamedTuple):
    """Hold what a floor cost. ping_ms: (n,) processor time of each ping; notices: codes of those raised."""

    ping_ms: Plane
    mission_s: float
    n_contacts: int
    notices: tuple[str, ...]


class LedgerStep(NamedTuple):
    """Hold what a ledger of n_contacts costs: ms per detection, bytes on disk, resident bytes of this process."""

    n_contacts: int
    detection_ms: float
    disk_bytes: int
    resident_bytes: int


def speckle(random: np.random.Generator, shape: tuple[int, int]) -> Plane:
    """Draw bare sea floor."""
    return random.exponential(1.0, shape)


def crowded(random: np.random.Generator, shape: tuple[int, int]) -> Plane:
    """Draw an object every 3 m along the track and every 4 m across, each with its shadow."""
    plane = np.ones(shape)
    n_across, sample_m = shape[1], _RANGE_M / shape[1]
    rows_m = _SPEED_MPS / _PING_RATE_HZ
    for near_m in np.arange(_ALTITUDE_M + 4.0, _RANGE_M - 6.0, 4.0):
        column, width = round(near_m / sample_m), round(0.4 / sample_m)
        shadow = round(min(0.4 * near_m / (_ALTITUDE_M - 0.4), 3.0) / sample_m)
        for first in np.arange(0, shape[0] * rows_m, 3.0):
            rows = slice(round(first / rows_m), round((first + 1.0) / rows_m))
            plane[rows, column : column + width] = 15.0
            plane[rows, column + width : min(column + width + shadow, n_across)] = 0.05
    return plane * random.exponential(1.0, shape)


def checkerboard(random: np.random.Generator, shape: tuple[int, int]) -> Plane:
    """Draw squares of a metre, 20 dB apart."""
    rows, samples = np.indices(shape)
    odd = (rows * (_SPEED_MPS / _PING_RATE_HZ)).astype(int) + (samples * (_RANGE_M / shape[1])).astype(int)
    return np.where(odd % 2 == 0, 1.0, 0.01) * random.exponential(1.0, shape)


def full_or_nothing(random: np.random.Generator, shape: tuple[int, int]) -> Plane:
    """Draw samples at either end of the recorder's range, blindly."""
    return np.where(random.random(shape) < 0.5, (_FULL_SCALE / _COUNTS) ** 2, 0.0)


def ripples(random: np.random.Generator, shape: tuple[int, int]) -> Plane:
    """Draw crests 1.2 m apart whose shadows are as long as those of small mines."""
    rows, samples = np.indices(shape)
    phase = (samples * (_RANGE_M / shape[1]) + 0.4 * rows * (_SPEED_MPS / _PING_RATE_HZ)) % 1.2
    return np.where(phase < 0.3, 6.0, np.where(phase < 0.7, 0.1, 1.0)) * random.exponential(1.0, shape)


def constant(random: np.random.Generator, shape: tuple[int, int]) -> Plane:
    """Draw every sample alike."""
    return np.ones(shape)


def silent(random: np.random.Generator, shape: tuple[int, int]) -> Plane:
    """Draw nothing at all."""
    return np.zeros(shape)


FLOORS: Final[dict[str, Callable[[np.random.Generator, tuple[int, int]], Plane]]] = {
    "bare": speckle,
    "ripples everywhere": ripples,
    "objects everywhere": crowded,
    "checkerboard": checkerboard,
    "full scale or nothing": full_or_nothing,
    "every sample alike": constant,
    "silent sonar": silent,
}


def floor_events(floor: str, n_pings: int) -> Iterator[SourceEvent]:
    """Yield the pings and navigation of a straight line over a drawn floor."""
    random = np.random.Generator(np.random.PCG64([7, list(FLOORS).index(floor)]))
    shape = (n_pings, _N_SAMPLES)
    sides = [FLOORS[floor](random, shape) for _ in range(2)]
    n_water = round(_ALTITUDE_M / _RANGE_M * _N_SAMPLES)
    if floor != "silent sonar":
        for plane in sides:
            plane[:, :n_water] = _WATER * random.exponential(1.0, (n_pings, n_water))
    amplitude = [np.minimum(_COUNTS * np.sqrt(plane), _FULL_SCALE).astype(np.uint16) for plane in sides]
    spacing_m = _RANGE_M / _N_SAMPLES
    for number in range(n_pings):
        time_s = _START_S + number / _PING_RATE_HZ
        latitude, longitude, _ = _HOME.to_geodetic(np.array([[0.0, _SPEED_MPS * number / _PING_RATE_HZ, 0.0]]))
        yield NavSample(
            time_s=time_s,
            latitude_deg=float(latitude[0]),
            longitude_deg=float(longitude[0]),
            heading_rad=0.0,
            pitch_rad=0.0,
            roll_rad=0.0,
            depth_m=_DEPTH_M - _ALTITUDE_M,
            altitude_m=_ALTITUDE_M,
            speed_mps=_SPEED_MPS,
        )
        port, starboard = (
            EchoTrace(samples=plane[number], first_range_m=0.5 * spacing_m, spacing_m=spacing_m) for plane in amplitude
        )
        yield Ping(number=number, time_s=time_s, port=port, starboard=starboard, transfer="amplitude")


def floor_cost(floor: str, n_pings: int, duty: float | None) -> FloorCost:
    """Feed a floor to the chain and take the processor time of each ping. duty: the budget, None for none."""
    config = msgspec.structs.replace(Config(), budget=BudgetConfig(duty=duty))
    pipeline, ping_ms, codes = Pipeline(config), list[float](), list[str]()
    for event in floor_events(floor, n_pings):
        began_s = time.process_time()
        given = pipeline.feed(event)
        if isinstance(event, Ping):
            ping_ms.append(1e3 * (time.process_time() - began_s))
        codes += [one.code for one in given if isinstance(one, Notice) and not one.for_the_record]
    codes += [one.code for one in pipeline.finish() if isinstance(one, Notice) and not one.for_the_record]
    return FloorCost(np.array(ping_ms), n_pings / _PING_RATE_HZ, len(pipeline.contacts), tuple(dict.fromkeys(codes)))


def ledger_steps(n_contacts: int, folder: Path) -> tuple[list[LedgerStep], float, int]:
    """Fill a ledger on disk and write all its results; returns its steps, s to write and bytes written.

    Raises SelfCheckError if the results lack a contact.
    """
    random = np.random.Generator(np.random.PCG64(3))
    side_m = math.sqrt(n_contacts / _PER_KM2 * 1e6)
    places = random.uniform(0.0, side_m, (n_contacts, 2))
    order = np.lexsort((places[:, 0], np.floor(places[:, 1] / 80.0)))  # as a lawnmower 80 m apart comes by
    places = places[order]
    steps, spent_s, known = list[LedgerStep](), list[float](), 0
    sizes = [n_contacts // 10**power for power in reversed(range(_STEPS)) if n_contacts // 10**power >= _AT_ONCE]
    with closing((folder / "contacts.records").open("w+b", buffering=0)) as file:
        store = ContactStore(RecordFile(file))
        ledger = Ledger(Config().contacts, 0.0, store)
        detection = _detection()
        for first in range(0, n_contacts, _AT_ONCE):
            new = places[first : first + _AT_ONCE]
            time_s = _START_S + first / _AT_ONCE * _APART_S
            batch = [_at(detection, place, time_s) for place in new]
            if first:  # a pass of its own over one that is known
                batch.append(_at(detection, places[random.integers(0, first)], time_s + 0.5 * _APART_S))
            began_s = time.process_time()
            ledger.add(batch)
            spent_s += [(time.process_time() - began_s) / len(batch)] * len(batch)
            known += len(new)
            if sizes and known >= sizes[0]:
                steps.append(
                    LedgerStep(
                        known,
                        1e3 * float(np.mean(spent_s[-_MEASURED:])),
                        os.fstat(file.fileno()).st_size,
                        _resident_bytes(),
                    )
                )
                sizes.pop(0)
        contacts: tuple[Contact, ...] = ledger.contacts
    began_s = time.process_time()
    write_results(folder, contacts, (), (), "load")
    wrote_s = time.process_time() - began_s
    n_written = len(json.loads((folder / "contacts.geojson").read_bytes())["features"])
    n_opened = contact_number(contacts[-1].id)  # ids are numbers in a row, and all of these contacts are reported
    if not n_written == len(contacts) == n_opened:
        raise SelfCheckError(f"of {n_opened} contacts {len(contacts)} were read and {n_written} are in the results")
    return steps, wrote_s, sum((folder / f"contacts.{kind}").stat().st_size for kind in _KINDS)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench load`."""
    parser.add_argument("--pings", type=count, help=f"pings of each floor (default {N_PINGS})")
    parser.add_argument("--contacts", type=count, help=f"contacts of the ledger (default {N_CONTACTS})")
    parser.add_argument("--quick", action="store_true", help=f"{_QUICK_PINGS} pings and {_QUICK_CONTACTS} contacts")
    parser.add_argument("--markdown", action="store_true", help="print the tables in Markdown")


def run(arguments: argparse.Namespace) -> int:
    """Print both tables; returns the exit code. Raises SelfCheckError for a contact that is lost."""
    n_pings = arguments.pings or (_QUICK_PINGS if arguments.quick else N_PINGS)
    n_contacts = arguments.contacts or (_QUICK_CONTACTS if arguments.quick else N_CONTACTS)
    table = markdown if arguments.markdown else columns
    rows = []
    for floor in FLOORS:
        for duty in (None, _DUTY):
            cost = floor_cost(floor, n_pings, duty)
            cells = [f"{value:.2f}" for value in np.quantile(cost.ping_ms, [0.5, 0.999, 1.0])]
            share = float(cost.ping_ms.sum()) / 1e3 / cost.mission_s
            rows.append(
                [
                    *(floor, "none" if duty is None else f"{duty:g}", *cells, f"{share:.3f}", str(cost.n_contacts)),
                    ", ".join(cost.notices) or "-",
                ]
            )
    header = ("floor", "budget", "ms a ping", "99.9 %", "most", "of one core", "contacts", "notices")
    print(f"{n_pings} pings a floor, {n_pings / _PING_RATE_HZ:.0f} s of mission each:\n\n" + table(header, rows))
    with tempfile.TemporaryDirectory(prefix="auv-mcm-load-") as name:
        steps, wrote_s, n_bytes = ledger_steps(n_contacts, Path(name))
    cells_of = [
        [
            str(step.n_contacts),
            f"{step.detection_ms:.2f}",
            f"{step.disk_bytes / _BYTES_PER_MB:.1f}",
            f"{step.resident_bytes / _BYTES_PER_MB:.0f}",
        ]
        for step in steps
    ]
    print("\n" + table(("contacts", "ms a detection", "MB on disk", "MB of memory"), cells_of))
    print(f"\nall contacts written in {wrote_s:.1f} s of processor time, {n_bytes / _BYTES_PER_MB:.0f} MB")
    return 0


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def _detection() -> Detection:
    return Detection(
        side="port",
        row=0.0,
        column=0.0,
        time_s=_START_S,
        ping_number=0,
        latitude_deg=_HOME.latitude_deg,
        longitude_deg=_HOME.longitude_deg,
        covariance_m2=np.eye(2),
        heading_rad=0.0,
        aspect_deg=270.0,
        ground_range_m=20.0,
        slant_range_m=20.6,
        altitude_m=_ALTITUDE_M,
        score=6.0,
        highlight_db=10.0,
        shadow_db=-8.0,
        length_m=1.0,
        width_m=0.5,
        height_m=0.4,
        shadow_length_m=1.6,
        p_mine=0.1,
        reasons=("highlight_and_shadow",),
        snippet=pack_snippet(np.ones((64, 96), dtype=np.float32)),
        snippet_row=32.0,
        snippet_column=48.0,
        row_spacing_m=0.12,
        column_spacing_m=0.06,
    )


def _at(detection: Detection, place_m: Plane, time_s: float) -> Detection:
    latitude, longitude, _ = _HOME.to_geodetic(np.array([[*place_m.tolist(), 0.0]]))
    return msgspec.structs.replace(
        detection, latitude_deg=float(latitude[0]), longitude_deg=float(longitude[0]), time_s=time_s
    )
