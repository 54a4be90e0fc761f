"""Read the YAML file beside a sonar image, which holds what the image itself does not."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.settings.strict_yaml import explain_validation_error, load_mapping, read_text
from auv_mcm.settings.vehicle_settings import Latitude, Longitude

Corner = tuple[Latitude, Longitude]
MAX_LENGTH_M: Final = 10_000.0  # m: beyond the range of any such sonar
Length = Annotated[float, Meta(gt=0.0, le=MAX_LENGTH_M)]
Pixel = Annotated[float, Meta(ge=0.001, le=2.0)]  # m: from finer than any sonar to coarser than any mine

_ASKED: Final = {
    "side": "the side that the sonar looks to, port or starboard",
    "near_edge": "the edge of the picture that lies nearest to the track: left, right, top or bottom",
    "pixel_along_m": "the pixel size along the track in metres",
    "pixel_across_m": "the pixel size across the track in metres",
    "range": "what a line is even in, slant or ground range",
    "near_range_m": "the range of the near edge in metres",
    "samples": "what a number is: amplitude, intensity, log or complex",
    "start_time": "when the first line was recorded, such as 2026-06-01T10:00:00Z",
}


class Corners(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hold latitude and longitude of the outer corners: of the near and far edge, at the first and last stored line."""

    near_first: Corner
    near_last: Corner
    far_first: Corner
    far_last: Corner


class Sidecar(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Describe an image whose lines follow each other along a straight or curved track.

    Lines are rows where near_edge is left or right, and columns where it is top or bottom. range: what the pixels of a
    line are even in; near_range_m is the near edge in it. altitude_m: of the sonar above the floor, or near_grazing_deg
    at the near edge instead. looks: averaged in each pixel; of complex samples, how many are formed. lines: backward
    where the last stored line was recorded first. speed_mps: at which lines follow each other in time. track: a CSV
    file with the position of the sonar by line; corners: of the image; neither for a GeoTIFF that holds its own. kind:
    of the sonar. resolution_along_m: of the processed aperture, the pixel size if not given. dataset: the one in an
    HDF5 file. squint_deg: of an image of a sub-aperture, the middle of its bearings, positive ahead of abeam.
    sub_apertures: formed from complex samples, each an image of its own; integration_deg, the bearings of the whole
    aperture, and positive_doppler, where positive frequencies along the track look, give their squints.
    """

    side: Literal["port", "starboard"]
    near_edge: Literal["left", "right", "top", "bottom"]
    pixel_along_m: Pixel
    pixel_across_m: Pixel
    range: Literal["slant", "ground"]
    near_range_m: Annotated[float, Meta(ge=0.0, le=MAX_LENGTH_M)]
    samples: Literal["amplitude", "intensity", "log", "complex"]
    start_time: str
    altitude_m: Length | None = None
    near_grazing_deg: Annotated[float, Meta(gt=0.0, lt=90.0)] | None = None
    db_per_count: Annotated[float, Meta(ge=0.01, le=10.0)] | None = None
    looks: Annotated[int, Meta(ge=1, le=64)] = 1
    lines: Literal["forward", "backward"] = "forward"
    speed_mps: Annotated[float, Meta(ge=0.1, le=20.0)] = 1.5
    track: str | None = None
    corners: Corners | None = None
    kind: Literal["side_scan", "sas"] = "sas"
    sound_speed_mps: Annotated[float, Meta(ge=1400.0, le=1600.0)] = 1500.0
    resolution_along_m: Pixel | None = None
    dataset: str | None = None
    squint_deg: Annotated[float, Meta(gt=-45.0, lt=45.0)] = 0.0
    sub_apertures: Annotated[int, Meta(ge=2, le=15)] | None = None
    integration_deg: Annotated[float, Meta(gt=0.0, le=60.0)] | None = None
    positive_doppler: Literal["ahead", "aft"] | None = None

    @property
    def start_s(self) -> float:
        """Return when the first line was recorded, s since 1970."""
        return _utc_s(self.start_time)

    @property
    def sonar_altitude_m(self) -> float:
        """Return the altitude as stated, or by the grazing angle at the near edge."""
        if self.altitude_m is not None:
            return self.altitude_m
        angle = math.radians(self.near_grazing_deg or 0.0)
        return self.near_range_m * (math.sin(angle) if self.range == "slant" else math.tan(angle))


def sidecar_path(image: Path) -> Path:
    """Name the sidecar of an image: survey.tif has survey.yaml."""
    return image.with_suffix(".yaml")


def read_sidecar(image: Path) -> Sidecar:
    """Read the sidecar of an image. Raises BadInputError where it is missing, incomplete or contradicts itself."""
    path = sidecar_path(image)
    if not path.exists():
        asked = "".join(f"\n  {key}: {meaning}" for key, meaning in _ASKED.items())
        raise BadInputError(
            f"{image} is an image without its sidecar {path.name}, and nothing of this is guessed. Write {path} "
            f"with:{asked}\n  altitude_m or near_grazing_deg, and corners or track unless a GeoTIFF holds its place"
        )
    try:
        data = load_mapping(read_text(path, "sidecar"), str(path), "a sidecar is a mapping of keys to values")
        return parse_sidecar(data, str(path))
    except UsageError as error:
        raise BadInputError(str(error)) from error


def parse_sidecar(data: dict[Any, Any], place: str) -> Sidecar:
    """Validate a sidecar; `place` names it in messages. Raises BadInputError."""
    for key, meaning in _ASKED.items():
        if key not in data:
            raise BadInputError(f"{place}: `{key}` is missing, and is never guessed: give {meaning}.")
    try:
        sidecar = msgspec.convert(data, Sidecar)
    except msgspec.ValidationError as error:
        raise BadInputError(f"{place}: {explain_validation_error(error, Sidecar)}") from error
    if problem := _contradiction(sidecar):
        raise BadInputError(f"{place}: {problem}")
    return sidecar


def _contradiction(sidecar: Sidecar) -> str:
    if (sidecar.altitude_m is None) == (sidecar.near_grazing_deg is None):
        return "give either `altitude_m` of the sonar above the floor, or `near_grazing_deg` at the near edge."
    if not sidecar.sonar_altitude_m >= 0.1:  # m: nothing sails nearer to the floor
        return "`near_grazing_deg` needs a `near_range_m` above 0: give `altitude_m` instead."
    if sidecar.samples == "log" and sidecar.db_per_count is None:
        return (
            "`samples` is log, so `db_per_count` is needed: give the decibels per count, for 8 bits over 60 dB "
            "60 / 255 = 0.235, or export the image as linear amplitude."
        )
    if sidecar.samples != "log" and sidecar.db_per_count is not None:
        return f"`db_per_count` is given, but `samples` is {sidecar.samples}: use `samples: log`, or remove it."
    if sidecar.sub_apertures is not None and (problem := _unformed(sidecar)):
        return problem
    if sidecar.track is not None and sidecar.corners is not None:
        return "`track` and `corners` are both given: keep the one that is right."
    if not math.isfinite(sidecar.start_s):
        return f"`start_time` is {sidecar.start_time!r}: write a date and time, such as 2026-06-01T10:00:00Z."
    return ""


def _unformed(sidecar: Sidecar) -> str:
    """Say why sub-apertures cannot be formed; empty if they can."""
    if sidecar.samples != "complex":
        return (
            f"`sub_apertures` are formed from complex samples, and `samples` is {sidecar.samples}: export the complex "
            "image, or give an image per sub-aperture with its `squint_deg`."
        )
    if sidecar.integration_deg is None or sidecar.positive_doppler is None:
        return (
            "`sub_apertures` needs `integration_deg`, the bearings of the whole aperture, and `positive_doppler`, "
            "ahead or aft: where positive frequencies along the track look."
        )
    if sidecar.looks > 1:
        return "`sub_apertures` and `looks` both part the spectrum: keep one."
    return ""


def _utc_s(text: str) -> float:
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        return math.nan
    return (when if when.tzinfo is not None else when.replace(tzinfo=UTC)).timestamp()
