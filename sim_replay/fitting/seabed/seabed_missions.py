"""Draw missions over several seabed types at once, each from its seed.

Floors, water, sonar, recorder, altitude and speed differ.

Seeds below FIRST_LIKE_SCENE draw every figure from a range and know nothing of the named scenes. From there on missions
are like one of the named scenes each: its sonar and covers, with seeds, patches, altitude, relief, noise and course of
their own.
"""

from __future__ import annotations

import math
from typing import Final

import msgspec
import numpy as np

from auv_mcm.records import SeabedType
from auv_mcm.settings.config import SonarConfig
from sim_replay.simulator import scene
from sim_replay.simulator.recording import complete
from sim_replay.simulator.scene import (
    Lawnmower,
    Motion,
    NavigationError,
    Ripples,
    SampleRecorder,
    Scatter,
    Scene,
    Seabed,
    Sonar,
    SyntheticAperture,
    TimeVariedGain,
    Track,
    World,
)
from sim_replay.simulator.scene_file import read_scene
from sim_replay.simulator.seabeds import USUAL

KIND_OF: Final[dict[scene.SeabedType, SeabedType]] = {
    "mud": "flat",
    "sand": "flat",
    "rippled_sand": "ripple",
    "gravel": "rough",
    "rock_outcrop": "rough",
    "boulder_field": "rough",
    "seagrass": "vegetation",
}
"""What each of the simulator's sea floors is to the payload."""

FIRST_LIKE_SCENE: Final = 4000  # first seed of missions that resemble the named scenes
LIKE: Final = ("flat", "ripple", "mixed", "rough", "boulders", "seagrass", "slope", "shallow", "deep", "sas")

Rng = np.random.Generator

_STREAM: Final = 0x464C4F4F  # "FLOO": its own stream of random numbers
_LAW_STREAM: Final = 0x4C4157  # "LAW": another one
_LAW_ERROR: Final = (0.8, 1.25)  # of decibels per count, by which an estimate from speckle may be off
_LAW_ERROR_LIKE_SCENE: Final = (0.6, 1.25)  # over reefs, whose echoes vary more than speckle does, it comes out low
_LEG_M: Final = 150.0  # m
_P_KIND: Final = 0.65  # that a kind of sea floor is in a mission; two are at least
_FLAT: Final[tuple[tuple[scene.SeabedType, ...], ...]] = (("sand",), ("mud",), ("sand", "mud"))
_ROUGH: Final[tuple[scene.SeabedType, ...]] = ("gravel", "rock_outcrop", "boulder_field")
_SOUND_MPS: Final = 1500.0  # m/s
_MAX_PING_RATE: Final = 0.9  # of those that the way of sound to the end of the range and back allows
_P_APERTURE: Final = 0.1  # of a synthetic aperture
_P_UNUSUAL: Final = 0.35  # that the covers of a mission differ much from what is usual
_USUAL_SPREAD: Final = 0.3  # of what differs from the usual, where a mission that differs much has 1
_P_SLOPE: Final = 0.3  # share of missions over a slope
_P_SHALLOW: Final = 0.2  # of water so shallow that the surface is heard


def mission_scene(seed: int) -> Scene:
    """Draw the mission of a seed."""
    return _free_scene(seed) if seed < FIRST_LIKE_SCENE else _like_scene(seed)


def _like_scene(seed: int) -> Scene:
    """Draw a short mission like a named scene, in turns of LIKE."""
    rng = np.random.Generator(np.random.PCG64([seed, _STREAM]))
    like = read_scene(LIKE[seed % len(LIKE)])
    world, sonar, track = like.world, like.sonar, like.track
    seabeds = tuple(
        msgspec.structs.replace(
            seabed, share=seabed.share * _log_uniform(rng, 0.5, 2.0), ripples=_turned(rng, seabed.ripples)
        )
        for seabed in world.seabeds
    )
    return msgspec.structs.replace(
        like,
        name=f"seabed {seed}, like {like.name}",
        seed=seed,
        world=msgspec.structs.replace(
            world,
            seabeds=seabeds,
            patch_m=world.patch_m * _log_uniform(rng, 0.7, 1.4),
            relief_rms_m=world.relief_rms_m * _log_uniform(rng, 0.7, 1.4),
            slope_towards_deg=float(rng.uniform(0.0, 360.0)),
        ),
        sonar=msgspec.structs.replace(sonar, noise_db=sonar.noise_db + float(rng.uniform(-2.0, 2.0))),
        track=msgspec.structs.replace(
            track,
            plan=Lawnmower(
                heading_deg=float(rng.uniform(0.0, 360.0)), n_legs=2, leg_m=_LEG_M, spacing_m=1.4 * sonar.range_m
            ),
            altitude_m=track.altitude_m * _log_uniform(rng, 0.88, 1.14),
            speed_mps=track.speed_mps * float(rng.uniform(0.9, 1.1)),
            pings_in_turns=False,
            motion=_motion(rng),
        ),
        scatter=tuple(
            msgspec.structs.replace(some, count=math.ceil(some.count / 4), ground_range_m=None) for some in like.scatter
        ),
    )


def _turned(rng: Rng, ripples: Ripples | None) -> Ripples | None:
    """Return ripples of another direction and about the same size; usual where the scene leaves them open."""
    if ripples is None:
        return None
    scale = _log_uniform(rng, 0.85, 1.18)
    return msgspec.structs.replace(
        ripples,
        wavelength_m=scale * ripples.wavelength_m,
        height_m=scale * ripples.height_m,
        direction_deg=float(rng.uniform(0.0, 180.0)),
    )


def _free_scene(seed: int) -> Scene:
    """Draw a mission with two to four kinds of sea floor in patches of any size, recorded in any way that recorders
    have."""
    rng = np.random.Generator(np.random.PCG64([seed, _STREAM]))
    # Frequency band, range and what usually goes with them: coarse and far, usual, fine and near.
    band = int(rng.choice(3, p=(0.15, 0.65, 0.2)))
    frequency_khz = float(rng.choice(((230.0, 300.0), (400.0, 450.0, 600.0), (700.0, 900.0))[band]))
    range_m = float(rng.uniform(*((65.0, 110.0), (35.0, 75.0), (20.0, 35.0))[band]))
    altitude_m = range_m * float(rng.uniform(0.08, 0.16))
    resolution_m = float(rng.uniform(*((0.08, 0.13), (0.04, 0.1), (0.03, 0.06))[band]))
    depth_m = altitude_m + float(rng.uniform(*((2.0, 5.0) if rng.uniform() < _P_SHALLOW else (8.0, 60.0))))
    shallow = depth_m < altitude_m + 6.0
    aperture = _aperture(rng)
    spacing_m = 1.2 * range_m
    return Scene(
        name=f"seabed {seed}",
        seed=seed,
        world=World(
            depth_m=depth_m,
            seabeds=_seabeds(rng),
            patch_m=_log_uniform(rng, 25.0, 120.0),
            slope_deg=_slope_deg(rng, depth_m - altitude_m, math.hypot(_LEG_M, spacing_m)),
            slope_towards_deg=float(rng.uniform(0.0, 360.0)),
            relief_rms_m=_log_uniform(rng, 0.02, 0.35),
            relief_outer_m=float(rng.uniform(20.0, 60.0)),
        ),
        sonar=Sonar(
            frequency_khz=frequency_khz,
            range_m=range_m,
            n_samples=math.ceil(range_m / float(rng.uniform(0.5, 0.75)) / resolution_m),
            ping_rate_hz=min(float(rng.uniform(10.0, 18.0)), _MAX_PING_RATE * _SOUND_MPS / (2.0 * range_m)),
            range_resolution_m=resolution_m,
            speckle_along_track_m=max(float(rng.uniform(-0.2, 0.3)), 0.0),
            beam_width_deg=float(rng.uniform(0.25, 0.65)),
            noise_db=float(rng.uniform(-28.0, -15.0)),
            surface_echo_db=float(rng.uniform(-26.0, -12.0)) if shallow else None,
            second_bottom_db=float(rng.uniform(-26.0, -12.0)) if shallow else None,
            crosstalk_db=float(rng.uniform(-45.0, -28.0)) if rng.uniform() < 0.3 else None,
            gain=_gain(rng, frequency_khz),
            recorder=_recorder(rng),
            synthetic_aperture=aperture,
        ),
        track=Track(
            plan=Lawnmower(heading_deg=float(rng.uniform(0.0, 360.0)), n_legs=2, leg_m=_LEG_M, spacing_m=spacing_m),
            speed_mps=float(rng.uniform(1.4, 2.3)),
            altitude_m=altitude_m,
            pings_in_turns=False,
        ),
        navigation_error=NavigationError(altitude_bias_percent=float(rng.uniform(1.0, 4.0))),
        scatter=(
            Scatter(kind="cylinder", count=4, strength_db=(-24.0, -8.0)),
            Scatter(
                kind="rock",
                count=int(rng.integers(5, 30)),
                natural_sizes=True,
                length_m=(0.4, 2.2),
                height_m=(0.2, 0.6),
            ),
        ),
    )


def _aperture(rng: np.random.Generator) -> SyntheticAperture | None:
    if rng.uniform() >= _P_APERTURE:
        return None
    cell_m = float(rng.uniform(0.04, 0.08))
    return SyntheticAperture(along_track_resolution_m=cell_m, range_resolution_m=cell_m, pixels_per_resolution=1.25)


def _motion(rng: np.random.Generator) -> Motion:
    return Motion(
        roll_sigma_deg=_log_uniform(rng, 0.3, 4.0),
        pitch_sigma_deg=_log_uniform(rng, 0.3, 2.0),
        heading_sigma_deg=_log_uniform(rng, 0.2, 0.7),
        sway_sigma_m=float(rng.uniform(0.0, 0.3)),
        altitude_sigma_m=float(rng.uniform(0.05, 0.3)),
        current_mps=float(rng.uniform(0.0, 0.3)),
        current_towards_deg=float(rng.uniform(0.0, 360.0)),
    )


def sonar_config(scene: Scene) -> SonarConfig:
    """Configure a mission's sonar as somebody would who knows the recorder's law.

    Decibels per count are known only as well as `auto` does.
    """
    recorder = complete(scene.sonar.recorder)
    if not recorder.samples.startswith("log"):
        return SonarConfig(transfer="amplitude")
    rng = np.random.Generator(np.random.PCG64([scene.seed, _LAW_STREAM]))
    db_per_count = (recorder.db_per_count or 1.0) * _log_uniform(
        rng, *(_LAW_ERROR if scene.seed < FIRST_LIKE_SCENE else _LAW_ERROR_LIKE_SCENE)
    )
    return SonarConfig(transfer="log", db_per_count=min(max(db_per_count, 0.01), 10.0))


def _seabeds(rng: Rng) -> tuple[Seabed, ...]:
    """Draw two to four types.

    Flat and rough ones come in one to three covers, ripples in one or two directions.
    """
    kinds = rng.uniform(size=4) < _P_KIND
    while np.count_nonzero(kinds) < 2:
        kinds[int(rng.integers(4))] = True
    flat, ripple, rough, vegetation = kinds.tolist()
    covers: list[scene.SeabedType] = []
    if flat:
        covers += _FLAT[int(rng.choice(3, p=(0.45, 0.2, 0.35)))]
    if ripple:
        covers += ["rippled_sand"] * int(rng.choice((1, 2), p=(0.7, 0.3)))
    if rough:
        chosen = [cover for cover in _ROUGH if rng.uniform() < 0.5]
        covers += chosen or [_ROUGH[int(rng.integers(len(_ROUGH)))]]
    if vegetation:
        covers.append("seagrass")
    unusual = 1.0 if rng.uniform() < _P_UNUSUAL else _USUAL_SPREAD
    return tuple(_seabed(rng, cover, 2.0 ** float(rng.uniform(-1.0, 1.0)), unusual) for cover in covers)


def _seabed(rng: Rng, cover: scene.SeabedType, share: float, unusual: float) -> Seabed:
    """Draw one cover, its figures near the usual ones. unusual: 0 for no spread at all to 1 for the widest."""
    usual = USUAL[cover]

    def spread(factor: float) -> float:
        return float(factor ** (unusual * rng.uniform(-1.0, 1.0)))

    stones = {
        "gravel": usual.stones_per_ha * spread(2.5),
        "boulder_field": _log_uniform(rng, 700.0, 1500.0 * 8.0**unusual),  # to a bottom of nothing but stones
        "rock_outcrop": usual.stones_per_ha * spread(2.0),
        "sand": _log_uniform(rng, 1.0, 70.0),
        "rippled_sand": _log_uniform(rng, 1.0, 20.0),
    }
    ripples = None
    if cover == "rippled_sand":
        wavelength_m = _log_uniform(rng, 0.35, 1.9)
        # Height over wavelength; ripples that waves make are near 0.17 (P. L. Wiberg and C. K. Harris, J. Geophysical
        # Research 99, 1994).
        ripples = Ripples(
            wavelength_m=wavelength_m,
            height_m=float(rng.uniform(0.08, 0.16)) * wavelength_m,
            direction_deg=float(rng.uniform(0.0, 180.0)),
            defects=float(rng.uniform(0.1, 0.6)),
            skew=float(rng.uniform(0.0, 0.6)),
        )
    return Seabed(
        type=cover,
        share=share,
        ripples=ripples,
        relief_rms_m=usual.relief_rms_m * spread(1.6),
        texture_shape=usual.texture_shape * spread(1.6),
        texture_m=usual.texture_m * spread(1.4),
        stones_per_ha=stones.get(cover, usual.stones_per_ha),
        stone_m=usual.stone_m * spread(1.3),
        level_db=2.0 * unusual * float(rng.normal()),
    )


def _slope_deg(rng: Rng, water_m: float, reach_m: float) -> float:
    """Draw a slope for some missions, no steeper than leaves water below the surface over the whole plan."""
    if rng.uniform() >= _P_SLOPE:
        return 0.0
    steep_deg = float(rng.uniform(0.0, 8.0))
    return steep_deg if math.tan(math.radians(steep_deg)) * reach_m < water_m - 2.0 else 0.0


def _gain(rng: Rng, frequency_khz: float) -> TimeVariedGain:
    """Draw a gain that fits the water, or one that an operator left unchanged."""
    if rng.uniform() < 0.4:
        return TimeVariedGain()
    # Absorption of sea water is near 0.23 dB per km and kHz at these frequencies (R. E. Francois and G. R. Garrison,
    # JASA 72, 1982).
    usual_db_per_km = 0.23 * frequency_khz
    return TimeVariedGain(
        spreading_db=float(rng.uniform(20.0, 45.0)), absorption_db_per_km=usual_db_per_km * float(rng.uniform(0.3, 1.4))
    )


def _recorder(rng: Rng) -> SampleRecorder:
    """Draw amplitudes or logarithms, in 8 or 16 bits, from gains at which bright floors clip down to low ones."""
    samples = int(rng.choice(5, p=(0.35, 0.25, 0.1, 0.2, 0.1)))
    down = 0.05 ** max(float(rng.uniform(-0.6, 1.0)), 0.0)  # 1 for a third of the missions
    if samples == 0:
        return SampleRecorder(samples="amplitude_uint16", seabed_counts=3000.0 * down)
    if samples == 1:
        return SampleRecorder(samples="amplitude_uint8", seabed_counts=float(rng.uniform(12.0, 60.0)))
    if samples == 2:
        return SampleRecorder(samples="amplitude_float32")
    if samples == 3:
        db_per_count = float(rng.uniform(0.22, 0.5))
        return SampleRecorder(
            samples="log_uint8",
            db_per_count=db_per_count,
            seabed_counts=255.0 - float(rng.uniform(20.0, 40.0)) / db_per_count,
        )
    return SampleRecorder(samples="log_uint16")


def _log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(low * (high / low) ** rng.uniform())
