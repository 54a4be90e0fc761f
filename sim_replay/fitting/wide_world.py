"""Draw missions from broad continuous priors: sonars, recorders, sea floors, motion, targets and clutter.

The named scenes are ten points of the world. What is learnt from them alone carries over in rank and not in level, so
that weights are fitted on missions of which no two share a sonar, a recorder or a floor. Priors are ranges of what is
built and found, drawn evenly or, over more than a factor of three, evenly in the logarithm. They are not fitted to any
recorded line.
"""

from __future__ import annotations

from typing import Final, get_args

import numpy as np
from msgspec import structs

from sim_replay.simulator.plan import swath_m
from sim_replay.simulator.scene import (
    Lawnmower,
    Motion,
    NavigationError,
    ObjectKind,
    Ripples,
    SampleRecorder,
    Scatter,
    Scene,
    Seabed,
    SeabedType,
    Sonar,
    TargetKind,
    TimeVariedGain,
    Track,
    World,
)
from sim_replay.simulator.scene_file import check_scene

_STREAM: Final = 0x574F524C  # keeps these random numbers apart from others of the same seed
_SWEPT_M2: Final = 9000.0  # of sea floor per leg and side: room for some fifty objects
_SECOND_TYPES: Final = (1, 4)  # kinds of sea floor in one mission, fewest and most
_CELL_PER_PIXEL: Final = 0.5  # the floor is finer than the picture
_CLUTTER: Final[dict[ObjectKind, tuple[int, int]]] = {
    "boulder_cluster": (0, 3),
    "debris": (0, 4),
    "tyre": (0, 4),
    "pipe": (0, 2),
    "anchor_scar": (0, 3),
    "fish_school": (0, 2),
}
"""Fewest and most of each kind of clutter but stones."""


class _Draw:
    """Draw from one seed."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, _STREAM])))

    def evenly(self, low: float, high: float) -> float:
        return float(self._random.uniform(low, high))

    def by_factor(self, low: float, high: float) -> float:
        """Draw a positive number evenly in its logarithm."""
        return float(np.exp(self._random.uniform(np.log(low), np.log(high))))

    def whole(self, low: int, high: int) -> int:
        return int(self._random.integers(low, high + 1))

    def chance(self, p: float) -> bool:
        return bool(self._random.random() < p)

    def some(self, values: tuple[str, ...], n: int) -> list[str]:
        return [str(value) for value in self._random.permutation(values)[:n]]

    def span(self, low: float, high: float) -> tuple[float, float]:
        """Draw a range inside another."""
        one, other = sorted(self._random.uniform(low, high, 2).tolist())
        return one, other


def wide_scene(seed: int) -> Scene:
    """Draw the mission of a seed, with some thirty targets and as much clutter."""
    draw = _Draw(seed)
    sonar = _sonar(draw)
    altitude_m = min(max(sonar.range_m * draw.evenly(0.08, 0.2), 1.8), 20.0)
    track = Track(
        altitude_m=altitude_m,
        speed_mps=draw.evenly(1.0, 2.5),
        plan=Lawnmower(
            heading_deg=draw.evenly(0.0, 360.0),
            n_legs=2,
            leg_m=min(max(_SWEPT_M2 / sonar.range_m, 60.0), 250.0),
            spacing_m=sonar.range_m * draw.evenly(0.8, 1.6),
        ),
        motion=_motion(draw),
    )
    scene = Scene(
        name=f"wide-{seed}",
        seed=seed,
        world=_world(draw, altitude_m, sonar),
        sonar=sonar,
        track=track,
        navigation_error=_navigation_error(draw),
    )
    reach_m = swath_m(scene)
    return _checked(scene, (*_clutter(draw, altitude_m, reach_m), *_targets(draw, altitude_m, reach_m)))


def _checked(scene: Scene, scatter: tuple[Scatter, ...]) -> Scene:
    whole = structs.replace(scene, scatter=scatter)
    check_scene(whole, whole.name)
    return whole


def _sonar(draw: _Draw) -> Sonar:
    """Draw a sonar: what is heard from farther away is heard at a lower frequency, less finely and less often."""
    range_m = draw.by_factor(18.0, 110.0)
    frequency_khz = min(max(26_000.0 / range_m * draw.by_factor(0.6, 1.7), 100.0), 1400.0)
    pixel_m = max(range_m * draw.by_factor(0.0006, 0.0016), 0.015)
    return Sonar(
        frequency_khz=frequency_khz,
        range_m=range_m,
        n_samples=min(max(round(range_m / pixel_m), 300), 2500),
        ping_rate_hz=min(750.0 / range_m * draw.evenly(0.55, 0.98), 24.0),
        beam_width_deg=draw.by_factor(0.2, 1.1),
        vertical_beam_width_deg=draw.evenly(40.0, 65.0),
        tilt_deg=draw.evenly(15.0, 32.0),
        noise_db=draw.evenly(-32.0, -13.0),
        range_resolution_m=pixel_m * draw.by_factor(0.7, 2.5),
        speckle_along_track_m=0.0 if draw.chance(0.5) else draw.evenly(0.05, 0.35),
        looks=draw.whole(2, 8) if draw.chance(0.35) else 1,
        ring_down_m=draw.evenly(0.1, 1.2),
        surface_echo_db=draw.evenly(-20.0, -10.0) if draw.chance(0.2) else None,
        crosstalk_db=draw.evenly(-38.0, -26.0) if draw.chance(0.25) else None,
        second_bottom_db=draw.evenly(-20.0, -10.0) if draw.chance(0.15) else None,
        gain=TimeVariedGain(
            spreading_db=draw.evenly(22.0, 38.0),
            absorption_db_per_km=None if draw.chance(0.4) else 0.15 * frequency_khz * draw.by_factor(0.5, 1.7),
        ),
        recorder=_recorder(draw),
    )


def _recorder(draw: _Draw) -> SampleRecorder:
    """Draw what echoes are stored as. Two in five recorders store logarithms; one in three clips strong echoes."""
    clips = draw.chance(0.33)
    if draw.chance(0.4):
        return SampleRecorder(
            samples="log_uint8",
            db_per_count=draw.evenly(0.2, 0.5),
            seabed_counts=draw.evenly(130.0, 190.0) if clips else draw.evenly(80.0, 130.0),
        )
    if draw.chance(0.35):
        return SampleRecorder(samples="amplitude_uint8", seabed_counts=draw.by_factor(8.0, 60.0 if clips else 30.0))
    return SampleRecorder(
        samples="amplitude_uint16" if draw.chance(0.8) else "amplitude_float32",
        seabed_counts=draw.by_factor(300.0, 6000.0),
        full_scale=32_767 if clips else 65_535,
    )


def _world(draw: _Draw, altitude_m: float, sonar: Sonar) -> World:
    kinds = draw.some(get_args(SeabedType), draw.whole(*_SECOND_TYPES))
    return World(
        depth_m=altitude_m + draw.by_factor(3.0, 60.0),
        seabeds=tuple(_seabed(draw, kind) for kind in kinds),
        patch_m=draw.by_factor(12.0, 120.0),
        relief_rms_m=draw.by_factor(0.02, 0.3),
        relief_outer_m=draw.evenly(15.0, 60.0),
        sand_waves=_ripples(draw, 6.0, 40.0, 0.03) if draw.chance(0.2) else None,
        backscatter="apl_uw" if draw.chance(0.75) else "lambert",
        cell_m=min(max(_CELL_PER_PIXEL * sonar.range_m / sonar.n_samples * 2.0, 0.04), 0.08),
    )


def _seabed(draw: _Draw, kind: str) -> Seabed:
    """Draw a kind of sea floor that is more or less what its type usually is."""
    rough = kind in ("rock_outcrop", "boulder_field")
    return Seabed(
        type=kind,  # type: ignore[arg-type]  # of the types
        share=draw.by_factor(0.15, 1.0),
        relief_rms_m=None if rough or draw.chance(0.5) else draw.by_factor(0.002, 0.03),
        ripples=_ripples(draw, 0.25, 2.5, 0.08) if kind == "rippled_sand" or draw.chance(0.15) else None,
        texture_shape=draw.by_factor(2.0, 60.0),
        texture_m=draw.by_factor(0.3, 4.0),
        stones_per_ha=None if draw.chance(0.4) else draw.by_factor(1.0, 900.0),
        stone_m=draw.by_factor(0.12, 0.5),
        level_db=draw.evenly(-6.0, 6.0),
    )


def _ripples(draw: _Draw, shortest_m: float, longest_m: float, steepness: float) -> Ripples:
    wavelength_m = draw.by_factor(shortest_m, longest_m)
    return Ripples(
        wavelength_m=wavelength_m,
        height_m=wavelength_m * steepness * draw.by_factor(0.5, 2.0),
        direction_deg=draw.evenly(0.0, 360.0),
        defects=draw.evenly(0.0, 1.0),
        skew=draw.evenly(0.0, 1.0),
    )


def _motion(draw: _Draw) -> Motion:
    return Motion(
        roll_sigma_deg=draw.by_factor(0.3, 4.0),
        pitch_sigma_deg=draw.by_factor(0.2, 2.0),
        heading_sigma_deg=draw.by_factor(0.1, 1.0),
        attitude_period_s=draw.evenly(2.5, 8.0),
        sway_sigma_m=draw.by_factor(0.03, 0.3),
        altitude_sigma_m=draw.by_factor(0.03, 0.3),
        current_mps=draw.evenly(0.0, 0.35),
        current_towards_deg=draw.evenly(0.0, 360.0),
    )


def _navigation_error(draw: _Draw) -> NavigationError:
    return NavigationError(
        position_sigma_m=draw.by_factor(0.2, 1.0),
        heading_bias_sigma_deg=draw.by_factor(0.1, 0.8),
        altitude_bias_percent=draw.by_factor(0.5, 5.0),
        sound_speed_bias_mps=draw.evenly(-8.0, 8.0),
    )


def _targets(draw: _Draw, altitude_m: float, reach_m: float) -> tuple[Scatter, ...]:
    """Draw mines of all kinds, 0.4 to 2.7 m long, proud to half buried."""
    near_m, far_m = 0.08 * reach_m, 0.97 * reach_m
    highest_m = 0.3 * altitude_m
    sizes: dict[TargetKind, dict[str, tuple[float, float]]] = {
        "cylinder": {"length_m": (0.9, 2.7), "width_m": (0.32, min(0.66, highest_m))},
        "sphere": {"width_m": (0.4, min(1.0, highest_m))},
        "truncated_cone": {"width_m": (0.6, 1.3), "height_m": (0.25, min(0.6, highest_m))},
        "wedge": {"length_m": (0.6, 1.5), "width_m": (0.5, 1.1), "height_m": (0.25, min(0.55, highest_m))},
        "box": {"length_m": (0.6, 1.6), "width_m": (0.4, 1.1), "height_m": (0.25, min(0.6, highest_m))},
    }
    return tuple(
        Scatter(
            kind=kind,
            count=draw.whole(4, 8),
            ground_range_m=(near_m, far_m),
            burial_m=(0.0, draw.evenly(0.0, 0.5) * min(span[1] for span in size.values())),
            tilt_deg=(-8.0, 8.0) if draw.chance(0.5) else (0.0, 0.0),
            scour_m=(0.0, draw.evenly(0.0, 0.12)),
            strength_db=_strength(draw),
            **size,  # type: ignore[arg-type]  # ranges of sizes alone
        )
        for kind, size in sizes.items()
    )


def _strength(draw: _Draw) -> tuple[float, float]:
    """Draw how strongly a kind echoes in a mission: from painted or overgrown to bare steel."""
    middle = draw.evenly(-24.0, -11.0)
    return middle - 5.0, middle + 5.0


def _clutter(draw: _Draw, altitude_m: float, reach_m: float) -> tuple[Scatter, ...]:
    """Draw stones of a mine's size, slabs and blocks among them, and other clutter."""
    highest_m = 0.35 * altitude_m
    heights_m = (0.12, min(0.8, highest_m))
    stones = (
        Scatter(
            kind="rock",
            count=draw.whole(10, 26),
            length_m=(0.4, 2.6),
            height_m=(heights_m[0], draw.evenly(0.3, heights_m[1]) if heights_m[1] > 0.3 else heights_m[1]),
            burial_m=(0.0, 0.15),
            strength_db=_strength(draw),
            natural_sizes=True,
        ),
        Scatter(
            kind="rock",
            count=draw.whole(4, 12),
            length_m=(0.6, 2.4),
            width_m=(0.4, 1.6),
            height_m=heights_m,
            burial_m=(0.0, 0.3),
            tilt_deg=(-20.0, 20.0),
            strength_db=_strength(draw),
        ),
    )
    scars = tuple(
        Scatter(kind="anchor_scar", count=n, length_m=(5.0, 16.0), width_m=(0.6, 2.5), height_m=(0.1, 0.3))
        for n in (draw.whole(*_CLUTTER["anchor_scar"]),)
        if n
    )
    others = (
        Scatter(kind=kind, count=n, strength_db=_strength(draw))
        for kind, (fewest, most) in _CLUTTER.items()
        if kind not in ("fish_school", "anchor_scar") and (n := draw.whole(fewest, most))
    )
    schools = tuple(Scatter(kind="fish_school", count=n) for n in (draw.whole(*_CLUTTER["fish_school"]),) if n)
    return (*scars, *stones, *others, *schools)
