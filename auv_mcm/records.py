"""Typed, frozen records that travel between stages.

Rows are pings (or along-track grid rows), columns are range. Angles are radians, clockwise from true north for
headings, bow up for positive pitch, starboard down for positive roll. An absent number is NaN, never zero.
"""

from __future__ import annotations

import math
from typing import Any, Final, Literal, NamedTuple, TypeAlias, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.clean_text import clean

Side: TypeAlias = Literal["port", "starboard"]
SIDES: Final[tuple[Side, Side]] = ("port", "starboard")

NAN: Final = float("nan")

# Bits of Tile.mask. A pixel counts in statistics when VALID is set and SATURATED is not.
VALID: Final = 1  # an echo was measured here and nothing speaks against it
SATURATED: Final = 2  # clipped: a lower bound, good evidence of a highlight, never background
# grazing too steep (several pixels from one sample) or too shallow: no detection, no coverage
LOW_RESOLUTION: Final = 4
TURN: Final = 8  # pixel spacing distorted by a turn: no coverage; what is found there says so


class EchoTrace(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold samples of one side of one ping, in the recorder's own numbers.

    samples: (n_samples,) any real dtype, ordered near to far.
    first_range_m: slant range of the centre of sample 0. spacing_m: slant range between samples.
    """

    samples: NDArray[Any]
    first_range_m: float
    spacing_m: float


TransferKind: TypeAlias = Literal["amplitude", "intensity", "log"]


class Transfer(NamedTuple):
    """State how samples become intensity.

    db_per_count: NaN unless `kind` is "log". power: of linear samples, that is intensity, where it is not the 2 of an
    amplitude or the 1 of an intensity; NaN otherwise.
    """

    kind: TransferKind
    db_per_count: float = NAN
    power: float = NAN

    @property
    def intensity_power(self) -> float:
        """Return the power of linear samples that is intensity."""
        return self.power if math.isfinite(self.power) else 1.0 if self.kind == "intensity" else 2.0


class Ping(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold one transmission with its echoes.

    `time_s` is UTC seconds since 1970 of the transmit instant; `place` names file and ping for messages.

    transfer: what the samples are, where the sonar's own protocol says so. squint_rad: 0 for side scan and for a whole
    synthetic aperture; middle of a sub-aperture's bearings, positive ahead of abeam. Pings are given a sub-aperture at
    a time, each at its line's own time: what has another squint is another image of the same ground.

    first_return_m: slant range of the first bottom return as a person corrected it, NaN where nobody did.
    """

    number: int
    time_s: float
    port: EchoTrace | None
    starboard: EchoTrace | None
    sound_speed_mps: float = 1500.0
    altitude_m: float = NAN
    place: str = ""
    transfer: Literal["amplitude", "intensity"] | None = None
    squint_rad: float = 0.0
    first_return_m: float = NAN


class NavSample(msgspec.Struct, frozen=True, kw_only=True):
    """Hold what a navigation source knew at `time_s`. Any quantity it did not measure anew is NaN.

    position_leaps: the vehicle cannot have got there from the positions before. Perception judges which are right;
    nobody else may use this one. position_sigma_m: 1-sigma per axis where the source states one, as dead reckoning and
    inertial units do.
    """

    time_s: float
    latitude_deg: float = NAN
    longitude_deg: float = NAN
    heading_rad: float = NAN
    pitch_rad: float = NAN
    roll_rad: float = NAN
    depth_m: float = NAN
    altitude_m: float = NAN
    speed_mps: float = NAN
    position_leaps: bool = False
    position_sigma_m: float = NAN


class Notice(msgspec.Struct, frozen=True, kw_only=True):
    """Ask a person to do something, or report that this is settled.

    `code` is stable for scripts, `text` says what, where and what to do.

    Control characters in text and place, which may come from devices and file names, are written out as escapes.
    for_the_record: nobody has to do anything. The text stands among the remarks of the summary and of the report, not
    among the notices.
    """

    code: str
    text: str
    place: str = ""
    for_the_record: bool = False

    def __post_init__(self) -> None:
        msgspec.structs.force_setattr(self, "text", clean(self.text))
        msgspec.structs.force_setattr(self, "place", clean(self.place))


SourceEvent: TypeAlias = Ping | NavSample | Notice


class PoseTrack(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold vehicle poses at n instants; every array has shape (n,) and dtype float64 (`stale`: bool).

    Positions are those of the vehicle's navigation reference point. `heading_rad` is unwrapped along the track. `stale`
    marks instants farther from a navigation sample than the permitted gap, whose values are the nearest known ones, and
    instants at which fixes dispute the position. `position_sigma_m` is the 1-sigma per axis that age, disputes
    and what a source states of itself add to the configured error of a fix, `heading_sigma_rad` the one that a course
    in its place adds to a compass's; left out, they are 0.
    """

    time_s: NDArray[np.float64]
    latitude_deg: NDArray[np.float64]
    longitude_deg: NDArray[np.float64]
    depth_m: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    pitch_rad: NDArray[np.float64]
    roll_rad: NDArray[np.float64]
    speed_mps: NDArray[np.float64]
    altitude_m: NDArray[np.float64]
    stale: NDArray[np.bool_]
    position_sigma_m: NDArray[np.float64] = msgspec.field(default_factory=lambda: np.empty(0))
    heading_sigma_rad: NDArray[np.float64] = msgspec.field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        for name in ("position_sigma_m", "heading_sigma_rad"):
            if not getattr(self, name).size:
                msgspec.structs.force_setattr(self, name, np.zeros(self.time_s.shape))

    def __len__(self) -> int:
        return int(self.time_s.shape[0])


class Tile(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold a metric piece of one side's waterfall on the mission-fixed along-track grid.

    intensity: (n_rows, n_columns) float32, linear, local seabed mean about 1, 0 where not VALID. mask: (n_rows,
    n_columns) uint8, the bits above. first_row: mission grid index of row 0; rows [core_start, core_stop) (local
    indices) belong to this tile alone, the others are overlap. Column j covers ground range [j, j + 1) *
    column_spacing_m. pose, first_return_m, first_return_sigma_m, ping_number: per row. first_return_m is the slant
    range of the first bottom return and its 1-sigma, (n_rows,) float64. ping_number: (n_rows,) int64, -1 where the row
    has no ping. level: (n_rows, n) float32, nats: the local mean that was divided out, against the mission's mean so
    far at the same grazing angle (that of logarithms, so that speckle adds its own constant), in n equal parts of the
    columns, NaN where unknown; None for a tile by itself. squint_rad: of its pings.
    """

    side: Side
    index: int
    first_row: int
    core_start: int
    core_stop: int
    row_spacing_m: float
    column_spacing_m: float
    intensity: NDArray[np.float32]
    mask: NDArray[np.uint8]
    pose: PoseTrack
    first_return_m: NDArray[np.float64]
    first_return_sigma_m: NDArray[np.float64]
    ping_number: NDArray[np.int64]
    level: NDArray[np.float32] | None = None
    squint_rad: float = 0.0


class Surroundings(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold the sea floor around a detection, wide enough for any mine's shadow; kept until the detection is confirmed.

    codes: (n_rows, n_columns) uint8 codes of `auv_mcm.snippet`, 0 where nothing was measured. row, column: the
    detection inside it, fractional. first_ground_range_m: near edge of column 0. first_return_m: slant range of the
    first bottom return there.
    """

    codes: NDArray[np.uint8]
    row: float
    column: float
    first_ground_range_m: float
    first_return_m: float


ContactClass: TypeAlias = Literal["cylinder", "sphere", "truncated_cone", "wedge", "clutter", "unknown"]


class ShapeModel(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold the solid that explains a view best. sizes and sigma: m and radians by name, as in `auv_mcm.solids.shapes`.

    highlight, shadow: (n, 2) float64 outlines (row, column) in pixels of the detection's snippet; (0, 2) where there is
    none.
    """

    classification: ContactClass
    sizes: dict[str, float]
    sigma: dict[str, float]
    highlight: NDArray[np.float64]
    shadow: NDArray[np.float64]


class Confirmation(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold the results of confirming one detection.

    log_ratio: evidence for a mine against clutter, nats. shape_mass: (32,) float64 of `auv_mcm.classify.beliefs`, which
    kinds of mine it may be; mass: the same with log_ratio. half_turn_symmetric: the best solid looks alike from the
    opposite side. labels: (n, m) uint8 of `auv_mcm.confirm.region` for the pixels of the snippet; (0, 0) where the
    field was not solved. highlight, shadow: (n, 2) float64 contours (row, column) in pixels of the snippet; (0, 2)
    where there is none. model: None if no solid explains the view. rejected: the contours cannot be those of a mine,
    for the codes in `reasons`. n_not_refined: solids whose search ended before the beam was taken into account.
    """

    log_ratio: float
    shape_mass: NDArray[np.float64]
    mass: NDArray[np.float64]
    half_turn_symmetric: bool
    labels: NDArray[np.uint8]
    highlight: NDArray[np.float64]
    shadow: NDArray[np.float64]
    model: ShapeModel | None
    rejected: bool
    reasons: tuple[str, ...]
    n_not_refined: int = 0


Detector: TypeAlias = Literal["cascade", "contrast"]
"""What proposes places to measure: the trained cascade, or contrasts of highlight and shadow alone."""

CONTRAST_SHARE: Final = 0.4
"""What one deviation of contrast is worth in units of the cascade's score, as the odds fitted to both have it."""

MeasuredStep: TypeAlias = Literal["detector", "contours", "shape"]
LookStep: TypeAlias = Literal["detector", "verifier", "contours", "shape"]


class Detection(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold one object seen once, on one side, in one pass.

    row, column: highlight centroid on the mission grid (fractional pixels, row 0 at mission start). Sizes in metres;
    height_m from the shadow's length, NaN if no shadow was seen. score: evidence of highlight and shadow together, in
    standard deviations of the sea floor around. cascade_score: of the trained cascade, half a log-odds, NaN where it
    did not serve. aspect_deg: compass direction from sonar to object, [0, 360). depth_m: of the sea floor there below
    the surface, NaN where the vehicle's own is not known. snippet: (n, m) uint8 codes of `auv_mcm.snippet`, the
    intensity around the object, near range left, earlier pings on top; snippet_row, snippet_column: the centroid inside
    it. covariance_m2: (2, 2) float64 east/north. p_mine: of this view alone;
    p_by_step: after each step of confirmation (`detector`, `verifier`, `contours`, `shape`) that was taken.
    surroundings: until then. confirmation: None if there was no confirmation; `reasons` states why. kind_nats: of the
    verifier's kinds of mine, logarithms of their probabilities if it is one, up to a constant; () where it was not
    asked. squint_rad: of the pings, 0 for side scan.
    """

    side: Side
    row: float
    column: float
    time_s: float
    ping_number: int
    latitude_deg: float
    longitude_deg: float
    covariance_m2: NDArray[np.float64]
    heading_rad: float
    aspect_deg: float
    ground_range_m: float
    slant_range_m: float
    altitude_m: float
    score: float
    highlight_db: float
    shadow_db: float
    length_m: float
    width_m: float
    height_m: float
    shadow_length_m: float
    p_mine: float
    reasons: tuple[str, ...]
    snippet: NDArray[np.uint8]
    snippet_row: float
    snippet_column: float
    row_spacing_m: float
    column_spacing_m: float
    p_by_step: dict[LookStep, float] = {}
    surroundings: Surroundings | None = None
    confirmation: Confirmation | None = None
    cascade_score: float = NAN
    depth_m: float = NAN
    squint_rad: float = 0.0
    kind_nats: tuple[float, ...] = ()

    @property
    def strength(self) -> float:
        """Return what the detector that served ranks its detections by.

        Contrast alone, or the cascade's score and contrast together.
        """
        return self.score if math.isnan(self.cascade_score) else self.cascade_score + CONTRAST_SHARE * self.score


class Contact(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold an object on the sea floor, from one or more detections. `belief` sums to 1 over classes plus `unknown`.

    covariance_m2: (2, 2) float64 east/north of the fused position. views: its detections, in order of time.
    aspects_deg: compass direction from sonar to object per view, [0, 360). *_sigma_m: 1-sigma of the sizes, NaN where
    no shape was fitted. conflict: how far the views contradict each other, 0..1, NaN for one view. next_look_deg:
    compass directions to view from, the most informative first, each standing for its opposite as well; empty if
    a further view would hardly change the decision. false_alarms_per_km2: density of non-mines at least as mine-like
    that is to be expected in this mission, NaN where it is not known; false_alarms_95_per_km2: its 95 % interval.
    called:
    whether that is no more than the operator accepts; None before it was decided. mine_kind: the likeliest kind if it
    is a mine, which is its class once it is called.
    """

    id: str
    time_s: float
    latitude_deg: float
    longitude_deg: float
    covariance_m2: NDArray[np.float64]
    p_mine: float
    classification: ContactClass
    belief: dict[str, float]
    length_m: float
    width_m: float
    height_m: float
    aspects_deg: tuple[float, ...]
    reasons: tuple[str, ...]
    views: tuple[Detection, ...]
    length_sigma_m: float = NAN
    width_sigma_m: float = NAN
    height_sigma_m: float = NAN
    conflict: float = NAN
    next_look_deg: tuple[float, ...] = ()
    false_alarms_per_km2: float = NAN
    false_alarms_95_per_km2: tuple[float, float] = (NAN, NAN)
    called: bool | None = None
    mine_kind: ContactClass = "unknown"


def contact_id(number: int) -> str:
    """Write the id of a mission's contact, numbered from 1 in the order of first views."""
    return f"C{number:05d}"


def contact_number(name: str) -> int:
    """Read the number in an id. Raises ValueError for an id that is not C and a number."""
    if not (name.startswith("C") and name[1:].isdecimal()):
        raise ValueError(f"'{name}' is not a contact id: write C and a number, as in C12")
    return int(name[1:])


EARLY_NUMBERS: Final = 1_000_000
"""Numbers of early contacts where only a number goes, as on the wire to a vehicle, begin after this; no mission has so
many contacts."""


def early_id(number: int) -> str:
    """Give the id of a mission's early contact, numbered from 1."""
    return f"E{number:05d}"


def report_number(name: str) -> int:
    """Give the number that stands for a contact or an early contact on a wire.

    Raises ValueError for an id of neither.
    """
    if name.startswith("E") and name[1:].isdecimal():
        return EARLY_NUMBERS + int(name[1:])
    return contact_number(name)


EarlyState: TypeAlias = Literal["found", "became", "withdrawn"]


class EarlyContact(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold an object that a first examination shows before its tile is finished; it is announced and in no result.

    contact: one view of it, under an id of its own (`early_id`). state: `found` comes first, and once the tile is
    finished `became`, with the id of the contact that it is, or `withdrawn`.
    """

    contact: Contact
    state: EarlyState
    became: str = ""

    @property
    def reported(self) -> Contact:
        """Return the contact to report to a vehicle: without views, a class and p_mine once its tile is finished."""
        if self.state == "found":
            return self.contact
        return msgspec.structs.replace(
            self.contact, p_mine=0.0, classification="unknown", belief={"unknown": 1.0}, views=(), aspects_deg=()
        )


SeabedType: TypeAlias = Literal["flat", "ripple", "rough", "vegetation", "unknown"]
SEABED_TYPES: Final[tuple[SeabedType, ...]] = get_args(SeabedType)
"""`rough` is rock, stones and coarse ground; `unknown` is unlike all that was learnt."""


class SeabedCells(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold the seabed types that one side of one tile shows, in square cells.

    Cell (i, j) covers the tile's core from i * cell_m[0] on along track, and ground range [j, j + 1) * cell_m[1]; the
    last ones may be cut short. Arrays are (n_along, n_across): kind uint8, index into SEABED_TYPES; confidence float32,
    posterior probability of it, 0 where too little was measured to decide (the kind is `unknown` there). float32, NaN
    where there is none: ripple_rad, compass direction in which crests follow one another, [0, pi); wavelength_m, their
    distance; unevenness_db, standard deviation of mean echoes from cell to cell, within three cells of this one.
    """

    cell_m: tuple[float, float]
    kind: NDArray[np.uint8]
    confidence: NDArray[np.float32]
    ripple_rad: NDArray[np.float32]
    wavelength_m: NDArray[np.float32]
    unevenness_db: NDArray[np.float32]


class SurveyedCells(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold the cells that one side of one tile surveyed, in the mission's own plane.

    The cells are square; the plane touches the ellipsoid at the origin. Every array is (n,). Cell (east_index,
    north_index) int32 spans [index, index + 1) * cell_m. fraction float32: of its area that earned coverage here, times
    what the detector's budget allowed for. Means over that area, float32: ground_range_m, altitude_m, look_rad (compass
    direction from the sonar to it, [0, 2 pi)). seabed uint8: index into SEABED_TYPES of the kind that most of it is.
    The others are float32 as in `SeabedCells`.
    """

    origin_latitude_deg: float
    origin_longitude_deg: float
    cell_m: float
    east_index: NDArray[np.int32]
    north_index: NDArray[np.int32]
    fraction: NDArray[np.float32]
    ground_range_m: NDArray[np.float32]
    altitude_m: NDArray[np.float32]
    look_rad: NDArray[np.float32]
    seabed: NDArray[np.uint8]
    confidence: NDArray[np.float32]
    ripple_rad: NDArray[np.float32]
    wavelength_m: NDArray[np.float32]
    unevenness_db: NDArray[np.float32]


class CoveragePatch(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold sea floor that one side of one tile really covered.

    rings_deg: polygons as (n, 2) float64 arrays of longitude, latitude, closed, counter-clockwise. covered_m2: area of
    pixels that earned coverage. lost_m2: area by reason it earned none (`turn`, `low_resolution`, `invalid`,
    `stale_navigation`, `saturated`, `shadow` of something high, `over_budget`, `failed` processing).
    evaluated_fraction: of its places to look at, those that the detector's budget allowed for. cells: the same area
    cell by cell; None where no row could be placed on Earth. squint_rad: of its pings, as of `Ping`.
    """

    side: Side
    tile_index: int
    start_s: float
    stop_s: float
    rings_deg: tuple[NDArray[np.float64], ...]
    covered_m2: float
    lost_m2: dict[str, float]
    evaluated_fraction: float = 1.0
    cells: SurveyedCells | None = None
    squint_rad: float = 0.0


class Waypoint(msgspec.Struct, frozen=True, kw_only=True):
    """Hold one point of a proposed leg.

    `kind`: `start`, `turn`, `leg_entry`, `leg_exit`; `contact_id` names what the leg looks at.
    """

    leg: int
    kind: str
    latitude_deg: float
    longitude_deg: float
    heading_rad: float
    contact_id: str
    why: str


PipelineEvent: TypeAlias = Tile | Contact | EarlyContact | CoveragePatch | Notice
