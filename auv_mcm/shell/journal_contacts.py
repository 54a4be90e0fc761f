"""Read contacts back from the journal, as they were announced, where nothing else holds them any more."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Container
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from auv_mcm.records import NAN, Contact, ContactClass, contact_number

JOURNALLED: Final = "journalled"
"""A reason of contacts that the journal alone gives: they have neither views nor a picture."""
_ID: Final = re.compile(rb'"properties":\{"id":"(C\d{1,12})"')  # in a line that cannot be decoded


class _Properties(msgspec.Struct, rename={"classification": "class"}):
    id: str
    time: str | None
    p_mine: float
    classification: ContactClass
    belief: dict[str, float]
    covariance_m2: list[list[float | None]]
    reasons: list[str]
    aspects_deg: list[float | None] = []
    length_m: float | None = None
    width_m: float | None = None
    height_m: float | None = None
    length_sigma_m: float | None = None
    width_sigma_m: float | None = None
    height_sigma_m: float | None = None


class _Point(msgspec.Struct):
    coordinates: tuple[float, float]


class _Feature(msgspec.Struct):
    properties: _Properties
    geometry: _Point | None


class _Line(msgspec.Struct):
    contact: _Feature


def contacts_in(journal: Path, numbers: Container[int]) -> dict[int, Contact]:
    """Read contacts of these numbers, each as it was announced last, without its views. Raises OSError.

    A line that is damaged is passed over.
    """
    found: dict[int, Contact] = {}
    decoder = msgspec.json.Decoder(_Line)
    with journal.open("rb") as file:
        for text in file:
            with contextlib.suppress(msgspec.MsgspecError, ValueError):
                feature = decoder.decode(text).contact
                number = contact_number(feature.properties.id)
                if number in numbers:
                    found[number] = _contact(feature)
    return found


def id_in(line: bytes) -> str:
    """Find the id in a line of the journal that cannot be decoded; empty where that is damaged too."""
    match = _ID.search(line)
    return "" if match is None else match[1].decode("ascii")


def _contact(feature: _Feature) -> Contact:
    """Make a contact of what the journal says. Raises ValueError for what cannot be one."""
    of = feature.properties
    longitude_deg, latitude_deg = (NAN, NAN) if feature.geometry is None else feature.geometry.coordinates
    covariance_m2 = np.array(of.covariance_m2, dtype=np.float64)
    if covariance_m2.shape != (2, 2):
        raise ValueError(f"{of.id}: a covariance has 2 x 2 values")
    return Contact(
        id=of.id,
        time_s=NAN if of.time is None else datetime.fromisoformat(of.time).replace(tzinfo=UTC).timestamp(),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        covariance_m2=covariance_m2,
        p_mine=of.p_mine,
        classification=of.classification,
        belief=of.belief,
        length_m=_known(of.length_m),
        width_m=_known(of.width_m),
        height_m=_known(of.height_m),
        length_sigma_m=_known(of.length_sigma_m),
        width_sigma_m=_known(of.width_sigma_m),
        height_sigma_m=_known(of.height_sigma_m),
        aspects_deg=tuple(map(_known, of.aspects_deg)),
        reasons=(*of.reasons, JOURNALLED),
        views=(),
    )


def _known(value: Any) -> float:
    return NAN if value is None else float(value)
