"""What a synthetic side-scan mission is made of, and which missions cannot be."""

from __future__ import annotations

import math
from typing import Literal, TypeAlias

import msgspec

from auv_mcm.errors import UsageError
from auv_mcm.records import NAN
from sim_replay.xtf_writer import SampleType

ObjectKind: TypeAlias = Literal["sphere", "cylinder", "box", "rock", "point"]


class Leg(msgspec.Struct, frozen=True, kw_only=True):
    """A straight run from a start position; `heading_deg` is true heading there."""

    latitude_deg: float
    longitude_deg: float
    heading_deg: float
    length_m: float


class SceneObject(msgspec.Struct, frozen=True, kw_only=True):
    """Something on the sea floor, given either by latitude and longitude or by leg, distance along it and to starboard of it.

    sphere: diameter height_m. cylinder: lying, length_m, diameter height_m. box: length_m, width_m, height_m. rock: half an ellipsoid of
    those sizes. point: no size, one bin `highlight_db` above the mean sea floor at 15 degrees grazing. For the others highlight_db compares
    the material with the sea floor's at equal grazing. azimuth_deg: true direction of the long axis.
    """

    kind: ObjectKind
    latitude_deg: float = NAN
    longitude_deg: float = NAN
    leg: int = -1
    along_m: float = NAN
    across_m: float = NAN
    azimuth_deg: float = 0.0
    length_m: float = 0.0
    width_m: float = 0.0
    height_m: float = 0.0
    highlight_db: float = 5.0
    is_target: bool = True


class SyntheticScene(msgspec.Struct, frozen=True, kw_only=True):
    """A mission. Altitude along the way s is altitude_m + altitude_wave_m * sin(2 pi s / altitude_wavelength_m).

    turns: legs are connected by half circles (each leg must start abeam of the end of the one before, on the opposite heading); without,
    the vehicle is taken to the next start and pings fall silent for 10 s. noise_db: noise floor against the mean sea floor at 15 degrees
    grazing, whose root-mean-square amplitude is seabed_counts (150 for log_uint8). texture_nu: shape of the Gamma-distributed sea-floor
    texture (K-distributed echoes), 0 for none; its cells of texture_m lie fixed on the sea floor. looks: of the speckle. psf_sigma_samples:
    speckle correlation along range, 0 for none. ring_down_m: clipped samples after transmission.
    """

    legs: tuple[Leg, ...]
    objects: tuple[SceneObject, ...] = ()
    seed: int = 0
    start_time_s: float = 1_700_000_000.0
    speed_mps: float = 1.8
    ping_rate_hz: float = 15.0
    altitude_m: float = 5.0
    altitude_wave_m: float = 0.0
    altitude_wavelength_m: float = 50.0
    seabed_depth_m: float = 20.0
    pitch_deg: float = 0.0
    turns: bool = False
    range_m: float = 30.0
    n_samples: int = 1024
    sound_speed_mps: float = 1500.0
    beam_width_deg: float = 0.5
    noise_db: float = -25.0
    texture_nu: float = 0.0
    texture_m: float = 0.5
    looks: int = 1
    psf_sigma_samples: float = 0.0
    ring_down_m: float = 0.3
    samples: Literal["amplitude_uint16", "amplitude_float32", "log_uint8"] = "amplitude_uint16"
    seabed_counts: float = 3000.0
    full_scale: int = 32767
    db_per_count: float = 0.35

    @property
    def sample_type(self) -> SampleType:
        """What an XTF file stores these samples as."""
        kinds: dict[str, SampleType] = {"amplitude_uint16": "uint16", "amplitude_float32": "float32", "log_uint8": "uint8"}
        return kinds[self.samples]


def check_scene(scene: SyntheticScene) -> None:
    """Raises UsageError naming the first field that cannot be."""
    positive = (
        "speed_mps",
        "ping_rate_hz",
        "altitude_m",
        "altitude_wavelength_m",
        "range_m",
        "beam_width_deg",
        "texture_m",
        "seabed_counts",
    )
    for name in (*positive, "full_scale", "db_per_count", "n_samples", "looks"):
        _require(getattr(scene, name) > 0, f"scene.{name}", getattr(scene, name), "a number above 0")
    for name in ("noise_db", "start_time_s", "seabed_depth_m"):
        _require(math.isfinite(getattr(scene, name)), f"scene.{name}", getattr(scene, name), "a finite number")
    for name in ("texture_nu", "psf_sigma_samples", "ring_down_m", "altitude_wave_m", "seed"):
        _require(0 <= getattr(scene, name) < math.inf, f"scene.{name}", getattr(scene, name), "0 or more")
    _require(1400.0 <= scene.sound_speed_mps <= 1600.0, "scene.sound_speed_mps", scene.sound_speed_mps, "1400 to 1600 m/s")
    _require(-45.0 <= scene.pitch_deg <= 45.0, "scene.pitch_deg", scene.pitch_deg, "-45 to 45 degrees")
    _require(scene.n_samples >= 16, "scene.n_samples", scene.n_samples, "16 or more")
    _require(scene.altitude_m - scene.altitude_wave_m > 0.1, "scene.altitude_wave_m", scene.altitude_wave_m, "less than altitude_m - 0.1")
    highest = (scene.altitude_m + scene.altitude_wave_m) / math.cos(math.radians(scene.pitch_deg))
    _require(highest < scene.range_m, "scene.range_m", scene.range_m, f"more than the highest altitude ({highest:.1f} m)")
    travel_s = 2.0 * scene.range_m / scene.sound_speed_mps
    _require(
        scene.ping_rate_hz * travel_s <= 1.0, "scene.ping_rate_hz", scene.ping_rate_hz, f"at most {1.0 / travel_s:.1f} Hz for this range"
    )
    _require(bool(scene.legs), "scene.legs", "nothing", "at least one leg")
    for index, leg in enumerate(scene.legs):
        where = f"scene.legs[{index}]"
        _require(-90.0 <= leg.latitude_deg <= 90.0, f"{where}.latitude_deg", leg.latitude_deg, "-90 to 90 degrees")
        _require(-180.0 <= leg.longitude_deg <= 180.0, f"{where}.longitude_deg", leg.longitude_deg, "-180 to 180 degrees")
        _require(math.isfinite(leg.heading_deg), f"{where}.heading_deg", leg.heading_deg, "a direction in degrees")
        _require(0.0 < leg.length_m <= 5000.0, f"{where}.length_m", leg.length_m, "more than 0, at most 5000 m")
    for index, thing in enumerate(scene.objects):
        _check_object(thing, f"scene.objects[{index}]", len(scene.legs))


def _check_object(thing: SceneObject, where: str, n_legs: int) -> None:
    by_position = math.isfinite(thing.latitude_deg) and math.isfinite(thing.longitude_deg)
    by_leg = thing.leg >= 0 and math.isfinite(thing.along_m) and math.isfinite(thing.across_m)
    if by_position == by_leg:
        raise UsageError(f"{where}: give either latitude_deg and longitude_deg, or leg, along_m and across_m.")
    _require(not by_leg or thing.leg < n_legs, f"{where}.leg", thing.leg, f"0 to {n_legs - 1}")
    _require(math.isfinite(thing.azimuth_deg), f"{where}.azimuth_deg", thing.azimuth_deg, "a direction in degrees")
    _require(math.isfinite(thing.highlight_db), f"{where}.highlight_db", thing.highlight_db, "a finite number of decibels")
    needed = {"sphere": ("height_m",), "cylinder": ("length_m", "height_m"), "point": ()}.get(
        thing.kind, ("length_m", "width_m", "height_m")
    )
    for name in needed:
        _require(0.0 < getattr(thing, name) < 100.0, f"{where}.{name}", getattr(thing, name), f"above 0 and below 100 m for a {thing.kind}")


def _require(holds: bool, field: str, value: object, expected: str) -> None:
    if not holds:
        raise UsageError(f"{field} is {value}; it must be {expected}.")
