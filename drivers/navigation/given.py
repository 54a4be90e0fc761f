"""Hold what navigation units give, compare it, and make samples of it."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

from auv_mcm.geometry.fix_agreement import FixAgreement
from auv_mcm.records import NAN, NavSample
from auv_mcm.settings.port_settings import NavUnitSettings, Quantity
from drivers.navigation.corrections import AttitudeReading, HeadingReading, Position, SpeedReading, offset_m
from drivers.navigation.gnss_watch import Doubt, GnssWatch
from drivers.navigation.health import UnitHealth

N_SIGMA: Final = 3.0  # standard deviations: of sound values one in 370 is further off
# Differences that need no notice: the units measure at different places and instants.
SLACK: Final[dict[Quantity, float]] = {
    "position": 2.0,
    "heading": math.radians(2.0),
    "attitude": math.radians(3.0),
    "depth": 1.0,
    "altitude": 1.0,
    "speed": 0.3,
}


class Given(NamedTuple):
    """Hold the last value of a quantity from one unit. time_s: of the measurement, monotonic."""

    time_s: float
    value: Any


class Channel:
    """Hold the state of one quantity of one unit."""

    def __init__(
        self, source: str, unit: NavUnitSettings, surface_depth_m: float, agreement: FixAgreement[Given]
    ) -> None:
        """Start without a value.

        Parameters
        ----------
        source
            The unit.
        unit
            Its settings.
        surface_depth_m
            As far down a GNSS position counts.
        agreement
            Settles positions that contradict each other.
        """
        self.health = UnitHealth(source, unit.priority, unit.valid_s)
        self.watch = GnssWatch(surface_depth_m) if unit.surface_only else None
        self.doubt: Doubt | None = None  # of its newest position
        self.given: Given | None = None
        self.unit_time_s: float | None = None
        self.agreement = agreement
        self.n_disagree = 0
        self.disagrees = False


def apart_m(before: Given, after: Given) -> float:
    """Return the distance between two positions, m."""
    return math.hypot(*offset_m(before.value[:2], after.value[:2]))


def sample_of(utc_s: float, served: dict[Quantity, Any], position_leaps: bool = False) -> NavSample:
    """Make a sample of readings.

    Parameters
    ----------
    utc_s
        Of the sample, s since 1970.
    served
        The reading of each quantity.
    position_leaps
        Whether the position is not to be joined to the one before.
    """
    reported: dict[str, float] = {}
    for quantity, reading in served.items():
        match reading:
            case Position():
                reported.update(latitude_deg=reading.latitude_deg, longitude_deg=reading.longitude_deg)
                reported["position_sigma_m"] = reading.sigma_m if reading.is_stated else NAN
            case HeadingReading():
                reported["heading_rad"] = reading.heading_rad
            case AttitudeReading():
                reported.update(pitch_rad=reading.pitch_rad, roll_rad=reading.roll_rad)
            case SpeedReading():
                reported["speed_mps"] = reading.speed_mps
            case _:
                reported[f"{quantity}_m"] = reading
    return NavSample(time_s=utc_s, position_leaps=position_leaps, **reported)


def difference(quantity: Quantity, given: Given, reference: Given, max_speed_mps: float) -> float:
    """Return how far two values are apart beyond their errors and what can have changed between them.

    Parameters
    ----------
    quantity
        Of both.
    given, reference
        From two units.
    max_speed_mps
        Of the vehicle.
    """
    one, other = given.value, reference.value
    apart_s = abs(given.time_s - reference.time_s)
    match quantity:
        case "position":
            distance_m = math.hypot(*offset_m(one[:2], other[:2]))
            apart = distance_m - N_SIGMA * math.hypot(one.sigma_m, other.sigma_m) - max_speed_mps * apart_s
        case "heading":
            apart = (
                _angle(one.heading_rad - other.heading_rad)
                - N_SIGMA * math.hypot(one.sigma_rad, other.sigma_rad)
                - apart_s
            )
        case "attitude":
            apart = max(_angle(one.pitch_rad - other.pitch_rad), _angle(one.roll_rad - other.roll_rad)) - apart_s
        case "speed":
            apart = (
                abs(one.speed_mps - other.speed_mps) - N_SIGMA * math.hypot(one.sigma_mps, other.sigma_mps) - apart_s
            )
        case _:
            apart = abs(one - other) - max_speed_mps * apart_s
    return float(apart)


def _angle(difference_rad: float) -> float:
    return abs(math.remainder(difference_rad, 2.0 * math.pi))
