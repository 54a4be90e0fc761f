"""Read what is scored: a mission's contacts and the truth about its sea floor.

From contacts.geojson and truth.json.

Only what the score needs is asked for, so that files of other producers work: a position and `p_mine` per contact,
`area_km2` and the kind, position and `is_target` of each object. Further keys are used where they are and ignored where
not known.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple, TypeVar

import msgspec
from msgspec import Meta

from auv_mcm.clean_text import clean
from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.errors import BadInputError
from auv_mcm.records import NAN, Contact
from auv_mcm.safe_files import read_regular
from sim_replay.scoring.seabed_map import SeabedMap, decode

LatitudeDeg = Annotated[float, Meta(ge=-90.0, le=90.0)]
LongitudeDeg = Annotated[float, Meta(ge=-180.0, le=360.0)]

_CONTACTS_HINT: Final = (
    "A contacts file is a GeoJSON FeatureCollection of points with p_mine from 0 to 1, as auv-mcm replay writes it"
)
_TRUTH_HINT: Final = "A truth file holds area_km2 above 0 and objects, each with kind, lat, lon (degrees) and is_target"


class ReportedContact(NamedTuple):
    """Hold one contact as a mission reported it; NaN for what it does not state."""

    latitude_deg: float
    longitude_deg: float
    p_mine: float
    classification: str = "unknown"
    length_m: float = NAN
    width_m: float = NAN
    height_m: float = NAN
    sigma_m: float = NAN
    ground_range_m: float = NAN
    called: bool | None = None


class ObjectPass(msgspec.Struct, frozen=True, kw_only=True):
    """Hold a pass that saw an object, at this horizontal range across-track."""

    ground_range_m: Annotated[float, Meta(ge=0.0)]


class TruthObject(msgspec.Struct, frozen=True, kw_only=True):
    """Hold an object on the sea floor, `burial_m` of its height below it.

    `rise_m` is its height above the floor as it lies there; None if not stated: that of an object that is not tilted.
    `looks` is None if not stated, empty if the sonar never saw it.
    """

    kind: str
    latitude_deg: LatitudeDeg = msgspec.field(name="lat")
    longitude_deg: LongitudeDeg = msgspec.field(name="lon")
    is_target: bool
    length_m: float | None = None
    width_m: float | None = None
    height_m: float | None = None
    burial_m: float = 0.0
    rise_m: float | None = None
    seabed: str | None = None
    looks: tuple[ObjectPass, ...] | None = None

    def __post_init__(self) -> None:
        msgspec.structs.force_setattr(self, "kind", clean(self.kind))
        if self.seabed is not None:
            msgspec.structs.force_setattr(self, "seabed", clean(self.seabed))


class Truth(msgspec.Struct, frozen=True, kw_only=True):
    """Hold what lies in an area."""

    area_km2: Annotated[float, Meta(gt=0.0)]
    objects: tuple[TruthObject, ...]
    seabed_map: SeabedMap | None = None


class ScoredMission(NamedTuple):
    """Hold contacts and truth of one mission."""

    contacts: tuple[ReportedContact, ...]
    truth: Truth
    name: str = ""
    asked_per_km2: float = NAN  # false alarms that the operator accepts


class _Point(msgspec.Struct, frozen=True):
    type: Literal["Point"]
    coordinates: Annotated[list[float], Meta(min_length=2)]


class _Properties(msgspec.Struct, frozen=True):
    p_mine: Annotated[float, Meta(ge=0.0, le=1.0)]
    classification: str = msgspec.field(name="class", default="unknown")
    length_m: float | None = None
    width_m: float | None = None
    height_m: float | None = None
    sigma_m: float | None = None
    ground_range_m: float | None = None
    called: bool | None = None


class _Feature(msgspec.Struct, frozen=True):
    type: Literal["Feature"]
    geometry: _Point | None
    properties: _Properties


class _FeatureCollection(msgspec.Struct, frozen=True):
    type: Literal["FeatureCollection"]
    features: list[_Feature]


_Record = TypeVar("_Record")


def read_contacts(path: Path) -> tuple[ReportedContact, ...]:
    """Read a contacts file. Raises BadInputError naming the file, the feature and the key."""
    return parse_contacts(_read_json(path, _CONTACTS_HINT), str(path))


def read_truth(path: Path) -> Truth:
    """Read a truth file. Raises BadInputError naming the file, the object and the key."""
    return parse_truth(_read_json(path, _TRUTH_HINT), str(path))


def as_reported(contacts: Sequence[Contact], place: str) -> tuple[ReportedContact, ...]:
    """Report contacts as a mission's file would, and read them back."""
    return parse_contacts(json.loads(contacts_geojson(contacts)), place)


def parse_contacts(document: Any, place: str) -> tuple[ReportedContact, ...]:
    """Parse the contacts of decoded GeoJSON, in its order.

    A null geometry is a contact without a position. `place` is for messages. Raises BadInputError naming the feature
    and the key.
    """
    if isinstance(document, dict) and "area_km2" in document:
        raise BadInputError(f"{place}: a truth file where contacts belong. Give each CONTACTS first, then its TRUTH")
    collection = _convert(document, _FeatureCollection, place, _CONTACTS_HINT)
    return tuple(_contact(feature, f"{place}: features[{index}]") for index, feature in enumerate(collection.features))


def parse_truth(document: Any, place: str) -> Truth:
    """Parse the truth of decoded JSON.

    `place` is for messages. Raises BadInputError naming the object and the key.
    """
    if isinstance(document, dict) and document.get("type") == "FeatureCollection":
        raise BadInputError(f"{place}: contacts where a truth file belongs. Give each CONTACTS first, then its TRUTH")
    truth = _convert(document, Truth, place, _TRUTH_HINT)
    if truth.seabed_map is not None:
        try:
            decode(truth.seabed_map)
        except BadInputError as error:
            raise BadInputError(f"{place}: {error}") from error
    return truth


def _contact(feature: _Feature, place: str) -> ReportedContact:
    longitude_deg, latitude_deg = feature.geometry.coordinates[:2] if feature.geometry else (NAN, NAN)
    if abs(latitude_deg) > 90.0 or not (math.isnan(longitude_deg) or -180.0 <= longitude_deg <= 360.0):
        raise BadInputError(
            f"{place}.geometry.coordinates: [{longitude_deg:g}, {latitude_deg:g}] is not a position on Earth. "
            "GeoJSON orders [longitude, latitude]"
        )
    properties = feature.properties
    return ReportedContact(
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        p_mine=properties.p_mine,
        classification=clean(properties.classification),
        length_m=_or_nan(properties.length_m),
        width_m=_or_nan(properties.width_m),
        height_m=_or_nan(properties.height_m),
        sigma_m=_or_nan(properties.sigma_m),
        ground_range_m=_or_nan(properties.ground_range_m),
        called=properties.called,
    )


def _or_nan(value: float | None) -> float:
    return NAN if value is None else value


def _read_json(path: Path, hint: str) -> Any:
    try:
        return json.loads(read_regular(path))
    except OSError as error:
        raise BadInputError(f"{path} cannot be read: {error.strerror}. Check the path") from error
    except (ValueError, RecursionError) as error:
        raise BadInputError(f"{path} is not JSON: {error}. {hint}") from error


def _convert(document: Any, kind: type[_Record], place: str, hint: str) -> _Record:
    strange = _non_finite(document, "")
    if strange is not None:
        raise BadInputError(
            f"{place}: {strange} is not a finite number. Write null or leave it out where it is not needed. {hint}"
        )
    try:
        return msgspec.convert(document, kind)
    except msgspec.ValidationError as error:
        raise BadInputError(f"{place}: {str(error).replace('`$.', '`')}. {hint}") from error


def _non_finite(value: Any, path: str) -> str | None:
    """Find the path of the first number that is NaN or infinite, which Python's JSON reader accepts."""
    if isinstance(value, float):
        return None if math.isfinite(value) else path
    if isinstance(value, dict):
        inner = ((f"{path}.{key}" if path else key, item) for key, item in value.items())
    elif isinstance(value, list):
        inner = ((f"{path}[{index}]", item) for index, item in enumerate(value))
    else:
        return None
    return next((found for place, item in inner if (found := _non_finite(item, place)) is not None), None)
