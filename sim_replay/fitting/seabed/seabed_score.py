"""Compare the live map of the sea floor with the simulator's truth, square metre by square metre."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import SEABED_TYPES
from sim_replay.fitting.seabed.seabed_missions import KIND_OF
from sim_replay.scoring.seabed_map import NOT_SWEPT, SeabedMap, decode

Array = NDArray[np.float64]

UNKNOWN: Final = SEABED_TYPES.index("unknown")


class Shares(NamedTuple):
    """Hold shares of the area compared.

    right: of all of it, `unknown` counted wrong. unknown: without a kind. right_of_known: of what has a kind. NaN where
    there is no area.
    """

    right: float
    unknown: float
    right_of_known: float


def confusion_m2(clearance: Clearance, truth: SeabedMap) -> Array:
    """Measure how much of each true kind the map takes for what, (n_types, n_types) m².

    Truth runs down, both as in SEABED_TYPES.

    Every cell of the truth counts that the survey swept and the map has seen, at borders between kinds as well. Raises
    BadInputError for a truth whose rows are damaged.
    """
    cells = decode(truth)
    row, column = np.nonzero(cells != NOT_SWEPT)
    kinds = [KIND_OF[name] for name in truth.types]  # type: ignore[index]  # names of types
    kind_of_type = np.array([SEABED_TYPES.index(kind) for kind in kinds], dtype=np.int64)
    here = LocalFrame(latitude_deg=truth.latitude_deg, longitude_deg=truth.longitude_deg)
    there = LocalFrame(latitude_deg=clearance.origin_latitude_deg, longitude_deg=clearance.origin_longitude_deg)
    place = np.column_stack([(column + 0.5) * truth.cell_m, (row + 0.5) * truth.cell_m, np.zeros(len(row))])
    latitude, longitude, height = here.to_geodetic(place)
    index = np.floor(there.to_enu(latitude, longitude, height)[:, :2] / clearance.cell_m).astype(np.int64)
    east, north = index[:, 0] - clearance.first_east, index[:, 1] - clearance.first_north
    n_north, n_east = clearance.seabed.shape
    inside = (east >= 0) & (east < n_east) & (north >= 0) & (north < n_north)
    inside[inside] = clearance.seen[north[inside], east[inside]]
    true = kind_of_type[cells[row, column][inside]]
    mapped = clearance.seabed[north[inside], east[inside]].astype(np.int64)
    n = len(SEABED_TYPES)
    counts = np.bincount(true * n + mapped, minlength=n * n).reshape(n, n)
    return np.asarray(counts * truth.cell_m**2, dtype=np.float64)


def shares(area_m2: Array) -> Shares:
    """Sum up a confusion of areas."""
    total, unknown, right = float(area_m2.sum()), float(area_m2[:, UNKNOWN].sum()), float(np.trace(area_m2))
    return Shares(_share(right, total), _share(unknown, total), _share(right, total - unknown))


def _share(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else float("nan")
