"""Predict how likely one view finds a mine, by sea floor, range, altitude and ripples, from simulated missions.

The tables hold, per kind and band of range, the probability and its 95 % interval; between the middles of bands both go
linearly. Seen lower, the same range is grazed more flatly and shadows are longer: ranges count in the height flown,

    range as read = ground range * (altitude_m / altitude) ^ altitude_exponent,

with an exponent chosen by what predicts missions left out best. Ripples have three tables, by the angle between the
look and the direction in which crests follow one another: 0-30, 30-60 and 60-90 degrees, read linearly between their
middles. Tables hold for sea floor up to USUAL_UNEVENNESS_DB; every decibel more divides the odds by exp(loss_per_db).
"""

from __future__ import annotations

import math
from importlib import resources
from typing import Annotated, Final, Literal, NamedTuple, TypeAlias, get_args

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.model_file import read_model
from auv_mcm.records import NAN, SEABED_TYPES, SeabedType
from auv_mcm.settings.config import USUAL_BEAM_DEG, Config

Array: TypeAlias = NDArray[np.float64]

Floor: TypeAlias = Literal["flat", "ripple_across", "ripple_oblique", "ripple_along", "rough", "vegetation"]
FLOORS: Final[tuple[Floor, ...]] = get_args(Floor)
"""Floors with a table of their own; `across` looks across the crests, from where they follow one another."""
RIPPLES: Final = slice(1, 4)  # of FLOORS
ASPECTS_RAD: Final = (math.radians(15.0), math.radians(45.0), math.radians(75.0))
"""Middles of the three classes of ripples, in the order of FLOORS."""
_HALVED_AT_M: Final[dict[Floor, float]] = {
    "flat": 1.0,
    "ripple_across": 0.43,
    "ripple_oblique": 0.43,
    "ripple_along": 0.43,
    "rough": 0.2,
    "vegetation": 0.1,
}
"""Footprint along the track, m, with which a floor's mines are found half as often as by a narrow beam. Fitted, with
_LOSS_POWER, to 13,045 looks of beams of 0.25 to 3 degrees in the missions of seeds 950 to 957, on which no table was
fitted; at 0.4, 0.8, 1.3 and 2 degrees 0.69, 0.51, 0.36 and 0.23 were found."""
_LOSS_POWER: Final = 1.4  # of the footprint, fitted with it
USUAL_UNEVENNESS_DB: Final = 2.0
"""Unevenness of sea floor, as in `SeabedCells`, up to which tables hold: the median of relief up to 0.2 m.
Less promises no more: even floor elsewhere may hold fainter mines than the missions of the fit."""
STEEPEST_RAD: Final = math.radians(70.0)  # grazing angle beyond which, near the nadir, no mine is found
_FILE: Final = "detection_performance.json"

_Probability: TypeAlias = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
_Count: TypeAlias = Annotated[int, msgspec.Meta(ge=0)]


class CellView(NamedTuple):
    """Hold how cells are seen: parts that broadcast, as in `SurveyedCells`."""

    seabed: ArrayLike
    ground_range_m: ArrayLike
    altitude_m: ArrayLike
    look_rad: ArrayLike
    ripple_rad: ArrayLike
    unevenness_db: ArrayLike = NAN


class Band(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hold one band of range over one kind of floor.

    Views fitted on, how many found their target, the probability and its 95 % interval.
    """

    n_looks: _Count
    n_found: _Count
    p: _Probability
    low: _Probability
    high: _Probability

    def __post_init__(self) -> None:
        if self.n_found > self.n_looks:
            raise ValueError(f"{self.n_found} found in {self.n_looks} looks")
        if not self.low <= self.p <= self.high:
            raise ValueError(f"p {self.p} lies outside its interval {self.low} to {self.high}")


class Performance(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hold the tables.

    fitted_on: what they were fitted on. edges_m: of the bands, rising. floors: per floor of FLOORS its bands.
    beam_width_deg: the widest beam that they hold for. loss_per_db: of log-odds, for sea floor more uneven than usual.

    A look counts as having found a mine if it makes a contact that is called mine-like within 2 m. *_look_correlation:
    the part of a further view that adds nothing new, from within 15 degrees of an earlier one and from elsewhere.
    """

    fitted_on: str
    altitude_m: Annotated[float, msgspec.Meta(gt=0.0, le=200.0)]
    altitude_exponent: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
    edges_m: tuple[Annotated[float, msgspec.Meta(ge=0.0, le=2000.0)], ...]
    floors: dict[Floor, tuple[Band, ...]]
    same_look_correlation: _Probability
    other_look_correlation: _Probability
    beam_width_deg: Annotated[float, msgspec.Meta(gt=0.0, le=20.0)] = USUAL_BEAM_DEG
    loss_per_db: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.0

    def __post_init__(self) -> None:
        if len(self.edges_m) < 3 or not all(
            near < far for near, far in zip(self.edges_m, self.edges_m[1:], strict=False)
        ):
            raise ValueError(f"edges_m {list(self.edges_m)} must be three or more that rise")
        if missing := set(FLOORS) - self.floors.keys():
            raise ValueError(f"floors: there is no table of {', '.join(sorted(missing))}")
        for floor, bands in self.floors.items():
            if len(bands) != len(self.edges_m) - 1:
                raise ValueError(f"floors: {floor} has {len(bands)} bands where edges_m makes {len(self.edges_m) - 1}")

    def for_beam(self, beam_width_rad: float) -> Performance:
        """Give the tables for a beam: the wider its footprint along the track, the fewer mines are found.

        Of a footprint w, m, at the middle of a band, 1 / (1 + (w / w_half)^_LOSS_POWER) of what a narrow beam finds is
        left. A beam no wider than theirs, or 0 for a synthetic aperture, gives the tables as they are.
        """
        if beam_width_rad <= math.radians(self.beam_width_deg):
            return self
        edges = np.array(self.edges_m)
        slant_m = np.hypot(0.5 * (edges[1:] + edges[:-1]), self.altitude_m)

        def left(width_rad: float, floor: Floor) -> Array:
            return np.asarray(1.0 / (1.0 + (width_rad * slant_m / _HALVED_AT_M[floor]) ** _LOSS_POWER))

        floors: dict[Floor, tuple[Band, ...]] = {}
        for floor, bands in self.floors.items():
            share = left(beam_width_rad, floor) / left(math.radians(self.beam_width_deg), floor)
            floors[floor] = tuple(
                msgspec.structs.replace(band, p=band.p * part, low=band.low * part, high=band.high * part)
                for band, part in zip(bands, share.tolist(), strict=True)
            )
        return msgspec.structs.replace(self, floors=floors, beam_width_deg=math.degrees(beam_width_rad))

    def p_look(self, view: CellView) -> Array:
        """Compute the probability that one view of the whole of a cell finds a mine there.

        float64, as the view's parts broadcast. 0 where the grazing angle is beyond 70 degrees, farther than the last
        band, and where range or altitude is not known. An unknown floor is taken for the one with the minimum there,
        ripples of unknown direction as from the worst one, unknown unevenness as usual. Raises ValueError for a seabed
        that is not in SEABED_TYPES.
        """
        kind, ground, altitude, look, ripple, unevenness_db = np.broadcast_arrays(
            np.asarray(view.seabed), *(np.asarray(part, dtype=np.float64) for part in view[1:])
        )
        if kind.size and not (kind.min() >= 0 and kind.max() < len(SEABED_TYPES)):
            raise ValueError(
                f"seabed: {kind.min()} to {kind.max()}, where SEABED_TYPES has 0 to {len(SEABED_TYPES) - 1}"
            )
        by_floor = self.p_by_floor(ground, altitude)
        found = np.zeros(ground.shape)
        for index, name in enumerate(SEABED_TYPES):
            here = kind == index
            found[here] = _of_kind(name, by_floor[:, here], look[here], ripple[here])
        factor = np.exp(-self.loss_per_db * more_than_usual_db(unevenness_db))
        return np.asarray(found * factor / (found * factor + (1.0 - found)))

    def p_by_floor(self, ground_range_m: ArrayLike, altitude_m: ArrayLike) -> Array:
        """Read each table at ground ranges: (len(FLOORS), ...) probabilities, 0 where no mine is found."""
        range_m, edges = self.read_range_m(ground_range_m, altitude_m), np.array(self.edges_m)
        seen = range_m <= edges[-1]
        within = np.where(seen, range_m, 0.0)
        middle = 0.5 * (edges[1:] + edges[:-1])
        table = np.array([[band.p for band in self.floors[floor]] for floor in FLOORS])
        return np.stack([np.where(seen, np.interp(within, middle, row), 0.0) for row in table])

    def read_range_m(self, ground_range_m: ArrayLike, altitude_m: ArrayLike) -> Array:
        """Compute the range at which the tables are read, m.

        NaN where no mine is found: near the nadir and where range or altitude is not known.
        """
        ground, altitude = np.broadcast_arrays(
            np.asarray(ground_range_m, dtype=np.float64), np.asarray(altitude_m, dtype=np.float64)
        )
        with np.errstate(invalid="ignore"):
            seen = (altitude > 0.0) & (ground * math.tan(STEEPEST_RAD) >= altitude) & np.isfinite(ground)
        scale = (self.altitude_m / np.where(seen, altitude, 1.0)) ** self.altitude_exponent
        return np.where(seen, np.where(seen, ground, 0.0) * scale, np.nan)


def more_than_usual_db(unevenness_db: ArrayLike) -> Array:
    """Compute by how much sea floor is more uneven than tables hold for, 0 where that is not known."""
    return np.fmax(np.asarray(unevenness_db, dtype=np.float64) - USUAL_UNEVENNESS_DB, 0.0)


def aspect_rad(look_rad: ArrayLike, ripple_rad: ArrayLike) -> Array:
    """Compute the angle between a view and the succession of crests, [0, pi / 2]; NaN without ripples."""
    turned = np.asarray(look_rad, dtype=np.float64) - np.asarray(ripple_rad, dtype=np.float64)
    return np.asarray(np.abs(np.mod(turned + 0.5 * math.pi, math.pi) - 0.5 * math.pi))


def _of_kind(name: SeabedType, by_floor: Array, look_rad: Array, ripple_rad: Array) -> Array:
    """Select (n,) of (len(FLOORS), n) values for places that are all of one kind."""
    if name == "unknown":
        return np.asarray(by_floor.min(axis=0))
    if name != "ripple":
        return np.asarray(by_floor[FLOORS.index(name)])
    rippled = by_floor[RIPPLES]
    aspect = aspect_rad(look_rad, ripple_rad)
    known = np.isfinite(aspect)
    first, _, last = ASPECTS_RAD
    place = np.clip(2.0 * (np.where(known, aspect, first) - first) / (last - first), 0.0, 2.0)  # 0, 1, 2 at the middles
    weight = np.maximum(1.0 - np.abs(place - np.arange(3.0)[:, np.newaxis]), 0.0)
    return np.asarray(np.where(known, (weight * rippled).sum(axis=0), rippled.min(axis=0)))


def parse_performance(data: bytes, place: str) -> Performance:
    """Parse tables from JSON. Raises BadInputError naming `place` and what is wrong with it."""
    try:
        return msgspec.json.decode(data, type=Performance)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{place}: {error}. Write the file again with 'auv-mcm calibrate performance'") from error


def configured_performance(config: Config) -> Performance:
    """Read the tables that `detect.performance` names, for the beam of the configured sonar.

    Raises BadInputError for a file that cannot be read or is not such tables.
    """
    tables = read_model("detect.performance", config.detect.performance, parse_performance, shipped_performance)
    return tables.for_beam(config.sonar.beam_width_rad)


def shipped_performance() -> Performance:
    """Load the tables that ship with the package."""
    return parse_performance(resources.files("auv_mcm.clearance").joinpath(_FILE).read_bytes(), _FILE)
