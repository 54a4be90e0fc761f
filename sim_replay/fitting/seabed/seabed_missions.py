"""Missions over all kinds of sea floor at once, each drawn from its seed: floors, water, sonar and altitude differ from one to the next."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from auv_mcm.records import SeabedType
from sim_replay.simulator import scene
from sim_replay.simulator.scene import Lawnmower, Motion, NavigationError, Recorder, Ripples, Scatter, Scene, Seabed, Sonar, Track, World

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

_STREAM: Final = 0x53454142
_GAIN_STREAM: Final = 0x4741494E
_MUD_COUNTS: Final = 3000.0  # of amplitudes up to 32767
_LOWEST_GAIN: Final = 0.05  # amplitude; rock does not clip


def mission_scene(seed: int) -> Scene:
    """A scene with every kind of sea floor in patches large enough for whole windows of one kind.

    Missions of even seeds are recorded with a gain at which bright floors clip, as many are, those of odd ones with any lower gain.
    """
    rng = np.random.Generator(np.random.PCG64([seed, _STREAM]))
    wavelength_m = float(rng.uniform(0.6, 1.8))
    # Height over wavelength; ripples that waves make are near 0.17 (P. L. Wiberg and C. K. Harris, J. Geophysical Research 99, 1994).
    steepness = float(rng.uniform(0.09, 0.16))
    ripples = Ripples(
        wavelength_m=wavelength_m,
        height_m=steepness * wavelength_m,
        direction_deg=float(rng.uniform(0.0, 180.0)),
        defects=float(rng.uniform(0.1, 0.6)),
        skew=float(rng.uniform(0.0, 0.6)),
    )
    seabeds = (
        Seabed(type="mud", share=0.12, level_db=float(rng.uniform(-2.0, 2.0))),
        Seabed(type="sand", share=0.2, texture_shape=float(rng.uniform(6.0, 20.0)), level_db=float(rng.uniform(-2.0, 2.0))),
        Seabed(type="rippled_sand", share=0.26, ripples=ripples, level_db=float(rng.uniform(-2.0, 2.0))),
        Seabed(type="gravel", share=0.08, stones_per_ha=float(rng.uniform(150.0, 500.0)), level_db=float(rng.uniform(-2.0, 2.0))),
        Seabed(type="rock_outcrop", share=0.09, relief_rms_m=float(rng.uniform(0.2, 0.7)), level_db=float(rng.uniform(-2.0, 2.0))),
        # From single boulders to a bottom of nothing but stones.
        Seabed(
            type="boulder_field", share=0.14, stones_per_ha=800.0 * 22.0 ** float(rng.uniform()), level_db=float(rng.uniform(-2.0, 2.0))
        ),
        Seabed(type="seagrass", share=0.2, relief_rms_m=float(rng.uniform(0.08, 0.16)), level_db=float(rng.uniform(-2.0, 2.0))),
    )
    range_m = float(rng.choice([40.0, 50.0, 60.0]))
    altitude_m = float(rng.uniform(4.0, 9.0))
    gain = _LOWEST_GAIN ** float(np.random.Generator(np.random.PCG64([seed, _GAIN_STREAM])).uniform()) if seed % 2 else 1.0
    return Scene(
        name=f"seabed {seed}",
        seed=seed,
        world=World(depth_m=25.0, seabeds=seabeds, patch_m=60.0, relief_rms_m=float(rng.uniform(0.02, 0.08))),
        sonar=Sonar(
            frequency_khz=float(rng.choice([400.0, 450.0, 600.0])),
            range_m=range_m,
            n_samples=math.ceil(range_m / 0.045),
            ping_rate_hz=12.0,
            range_resolution_m=float(rng.uniform(0.04, 0.09)),
            speckle_along_track_m=float(rng.uniform(0.0, 0.25)),
            beam_width_deg=float(rng.uniform(0.3, 0.6)),
            noise_db=float(rng.uniform(-28.0, -16.0)),
            recorder=Recorder(seabed_counts=_MUD_COUNTS * gain),
        ),
        track=Track(
            plan=Lawnmower(heading_deg=float(rng.uniform(0.0, 360.0)), n_legs=2, leg_m=220.0, spacing_m=1.2 * range_m),
            speed_mps=float(rng.uniform(1.5, 2.2)),
            altitude_m=altitude_m,
            pings_in_turns=False,
            motion=Motion(current_mps=float(rng.uniform(0.0, 0.3)), current_towards_deg=float(rng.uniform(0.0, 360.0))),
        ),
        navigation_error=NavigationError(),
        scatter=(
            Scatter(kind="cylinder", count=3),
            Scatter(kind="rock", count=10, natural_sizes=True, length_m=(0.4, 2.0), height_m=(0.2, 0.6)),
        ),
    )
