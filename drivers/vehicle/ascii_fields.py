"""Read and write the fields of vehicles' sentences, and the fields of a contact.

Angles are radians, depths and altitudes metres, speeds m/s, times of day seconds since midnight UTC; an empty field is
NaN. What cannot be true of a vehicle is refused, since a checksum of eight bits lets one damaged sentence in 256 pass.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from itertools import chain, islice, repeat
from typing import Any, Final, get_args

from auv_mcm.records import ContactClass
from drivers.navigation.sentence_fields import Codec, within
from drivers.navigation.sentences import SENTENCES, Sentence
from drivers.vehicle.dialect import ContactReport

FOOT_M: Final = 0.3048  # m, the international foot
DEGREE: Final = math.pi / 180.0
_HALF_TURN: Final = math.pi
_MAX_KEY_FIELDS: Final = 3  # fields that name a sentence, before its values
_NO_TEXT: Final = re.compile(r"[^\x20-\x7e]|[,*$!#]")
_WHOLE: Final = re.compile(r"\d{1,20}")


class Table:
    """Hold the sentences of one dialect, each for both directions; a key is up to three fields long."""

    def __init__(self, *kinds: Sentence[Any]) -> None:
        self._by_key = {kind.key: kind for kind in kinds}
        self._by_record: dict[Any, Sentence[Any]] = {kind.make: kind for kind in kinds}

    @property
    def kinds(self) -> tuple[Sentence[Any], ...]:
        """Return every sentence."""
        return tuple(self._by_key.values())

    def parse(self, body: str) -> Any | None:
        """Decode a sentence's body to its record; None for an unknown kind.

        Raises ValueError for one that does not fit its kind.

        Fields missing at the end count as empty; codecs that need a value refuse that.
        """
        fields = body.split(",")
        kind = self.kind_of(fields)
        return None if kind is None else kind.make(*_values(kind, fields[kind.key.count(",") + 1 :]))

    def kind_of(self, fields: Sequence[str]) -> Sentence[Any] | None:
        """Return the kind of a sentence by the fields of its body; None for an unknown one."""
        for n_key in range(min(_MAX_KEY_FIELDS, len(fields)), 0, -1):
            kind = self._by_key.get(",".join(fields[:n_key]))
            if kind is not None:
                return kind
        return None

    def body_of(self, record: Any) -> str:
        """Encode a record of this table as a body."""
        kind = self._by_record[type(record)]
        values = iter(record)
        return ",".join(
            chain((kind.key,), *(("",) if codec is None else codec.write(next(values)) for codec in kind.codecs))
        )


def _values(kind: Sentence[Any], texts: Sequence[str]) -> Iterable[Any]:
    fields = chain(texts, repeat(""))
    for codec in kind.codecs:
        part = tuple(islice(fields, 1 if codec is None else codec.n_fields))
        if codec is not None:
            yield codec.read(part)


def _of(key: str) -> list[Codec]:
    """Return the codecs of a standard sentence."""
    return [codec for codec in SENTENCES[key].codecs if codec is not None]


def scaled(codec: Codec, unit: float) -> Codec:
    """Make the codec of a number. unit: the SI value of 1 on the wire."""
    return Codec(codec.n_fields, lambda fields: codec.read(fields) * unit, lambda value: codec.write(value / unit))


def needed(codec: Codec) -> Codec:
    """Make a codec that rejects an empty field."""

    def read(fields: Sequence[str]) -> Any:
        if not fields[0]:
            raise ValueError("a field is empty that must not be")
        return codec.read(fields)

    return Codec(codec.n_fields, read, codec.write)


def between(before: str, codec: Codec, after: str = "") -> Codec:
    """Make the codec of one field between fixed texts, such as `V1.50` or `1.5 meters/sec`."""

    def read(fields: Sequence[str]) -> Any:
        text = fields[0]
        if not (text.startswith(before) and text.endswith(after) and len(text) >= len(before) + len(after)):
            raise ValueError(f"not between {before!r} and {after!r}: {text}")
        return codec.read((text[len(before) : len(text) - len(after)],))

    return Codec(1, read, lambda value: (before + codec.write(value)[0] + after,))


def one_of(*words: str) -> Codec:
    """Make the codec of one of these words; an empty field only if it is one of them."""

    def read(fields: Sequence[str]) -> str:
        if fields[0] not in words:
            raise ValueError(f"not one of {', '.join(words)}: {fields[0]}")
        return fields[0]

    return Codec(1, read, lambda value: (value,))


def plain_text(text: str, max_chars: int) -> str:
    """Return a text without the characters that a field cannot hold, cut to max_chars."""
    return _NO_TEXT.sub(" ", text)[:max_chars]


def _read_whole(fields: Sequence[str]) -> int:
    if _WHOLE.fullmatch(fields[0]) is None:
        raise ValueError(f"not a whole number: {fields[0]}")
    return int(fields[0])


TEXT: Final = Codec(1, lambda fields: fields[0], lambda text: (plain_text(text, 80),))
WHOLE: Final = Codec(1, _read_whole, lambda value: (str(value),))
LATITUDE, LONGITUDE, CLOCK = _of("GLL")[:3]
TENTHS: Final = _of("GGA")[5]
CENTI: Final = _of("DPT")[0]
MILLI: Final = _of("PIXSE,SPEED_")[0]
COUNT: Final = _of("GGA")[3]


def heading(n_decimals: int) -> Codec:
    """Write degrees in [0, 360), also where rounding would make it 360."""
    degrees = (TENTHS, CENTI)[n_decimals - 1]
    read = within(scaled(degrees, DEGREE), 0.0, 2.0 * _HALF_TURN + 1e-9).read
    return Codec(1, read, lambda value: degrees.write(round(value / DEGREE, n_decimals) % 360.0))


HEADING: Final = heading(2)
PITCH: Final = within(scaled(CENTI, DEGREE), -0.5 * _HALF_TURN, 0.5 * _HALF_TURN)
ROLL: Final = within(scaled(CENTI, DEGREE), -_HALF_TURN, _HALF_TURN)


def depth(codec: Codec, unit: float = 1.0) -> Codec:
    """Make the codec of a depth or an altitude. unit: 1 on the wire, in m."""
    return within(scaled(codec, unit), -10.0, 12_000.0)


def speed(codec: Codec, unit: float = 1.0) -> Codec:
    """Make the codec of a speed. unit: 1 on the wire, in m/s."""
    return within(scaled(codec, unit), -30.0, 30.0)


DEPTH: Final = depth(CENTI)
SPEED: Final = speed(CENTI)


CLASSES: Final[tuple[ContactClass, ...]] = get_args(ContactClass)
_CLASS: Final = one_of(*CLASSES)
_SHARE: Final = within(needed(MILLI), 0.0, 1.0)
_SIZE: Final = within(CENTI, 0.0, 1000.0)
_SIGMA: Final = within(CENTI, 0.0, 1e6)
_BELIEF: Final = Codec(
    len(CLASSES),
    lambda fields: {name: _SHARE.read((field,)) for name, field in zip(CLASSES, fields, strict=True)},
    lambda belief: [_SHARE.write(belief.get(name, 0.0))[0] for name in CLASSES],
)
CONTACT_FIELDS: Final[dict[str, Codec]] = {
    "session": WHOLE,
    "number": WHOLE,
    "revision": WHOLE,
    "time_s": needed(MILLI),
    "latitude_deg": needed(LATITUDE),
    "longitude_deg": needed(LONGITUDE),
    "sigma_m": _SIGMA,
    "depth_m": DEPTH,
    "classification": _CLASS,
    "p_mine": _SHARE,
    "belief": _BELIEF,
    "n_views": WHOLE,
    "length_m": _SIZE,
    "length_sigma_m": _SIGMA,
    "width_m": _SIZE,
    "width_sigma_m": _SIGMA,
    "height_m": _SIZE,
    "height_sigma_m": _SIGMA,
}


def _read_contact(fields: Sequence[str]) -> ContactReport:
    rest = iter(fields)
    return ContactReport(
        **{name: codec.read(tuple(islice(rest, codec.n_fields))) for name, codec in CONTACT_FIELDS.items()}
    )


CONTACT: Final = Codec(
    sum(codec.n_fields for codec in CONTACT_FIELDS.values()),
    _read_contact,
    lambda report: list(
        chain.from_iterable(codec.write(getattr(report, name)) for name, codec in CONTACT_FIELDS.items())
    ),
)
"""Write a contact in 25 fields, for vehicles whose protocol has no sentence for one:

session, number, revision, time (UTC seconds since 1970), latitude (ddmm.mmmmmm, N or S), longitude (dddmm.mmmmmm, E or
W), 1-sigma of the position (m), depth of the sea floor (m), class, probability of a mine, belief in cylinder, sphere,
truncated_cone, wedge, clutter and unknown, number of views, then length, width and height, each followed by its 1-sigma
(m). Empty: not known.
"""
