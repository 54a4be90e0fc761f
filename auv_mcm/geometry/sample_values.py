"""Take the quantities out of a navigation sample, and say which values of them are possible."""

from __future__ import annotations

import math
from collections import Counter
from operator import attrgetter
from typing import Final

from auv_mcm.records import NAN, NavSample

MAX_SPEED_MPS: Final = 30.0  # no vehicle that carries this payload is faster; a fix that implies more is wrong
_FIELDS: Final = attrgetter(
    "latitude_deg", "longitude_deg", "heading_rad", "pitch_rad", "roll_rad", "depth_m", "altitude_m", "speed_mps"
)
# Valid range of each quantity after the position. A full turn rounded up by a source in single precision is still
# valid.
RANGES: Final = (
    ("heading", math.radians(-361.0), math.radians(361.0)),
    ("pitch", math.radians(-90.0), math.radians(90.0)),
    ("roll", math.radians(-181.0), math.radians(181.0)),
    ("depth", -100.0, 12_000.0),
    ("altitude", 1e-3, 12_000.0),  # zero: no bottom lock
    ("speed", -MAX_SPEED_MPS, MAX_SPEED_MPS),
)


def values_of(sample: NavSample, counters: Counter[str]) -> tuple[float, ...]:
    """Return latitude, longitude, heading and the quantities behind it in RANGES; NaN for what is not known.

    Parameters
    ----------
    sample
        Whose zeros are not measurements where its position is 0, 0: a record that was never filled.
    counters
        Of such zeros.
    """
    values: tuple[float, ...] = _FIELDS(sample)
    if values[0] != 0.0 or values[1] != 0.0:
        return values
    counters["navigation.position_zero"] += 1
    n_zeros = values[2:].count(0.0)
    if n_zeros:
        counters["navigation.zero_with_position"] += n_zeros
    return tuple(NAN if value == 0.0 else value for value in values)
