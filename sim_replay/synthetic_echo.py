"""Rendering one synthetic side-scan ping.

Height profiles are taken under the fan plane of a ping. A facet is seen if it is less depressed than all nearer ones (running minimum of
depression); its energy goes to the bins of its slant range, so layover and shadow need no special case. Speckle is drawn per slant-range
bin: a bin holds one resolution cell, however many facets feed it. Perfect time-varied gain is assumed: on flat ground the mean intensity is
Lambert's sin^2 of the grazing angle times the footprint's 1/cos, and the noise floor is level. Not modelled: targets in the water column,
surface echo, multipath, beam pattern over depression; so roll changes nothing. The vehicle travels while the echo does: range r is seen
from where the vehicle is r / c after transmission, midway between transmitting and receiving.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import EchoTrace
from sim_replay.synthetic_scene import ObjectKind, SyntheticScene

Floats: TypeAlias = NDArray[np.float64]

REFERENCE_GRAZING_RAD: Final = math.radians(15.0)
_REFERENCE_INTENSITY: Final = math.sin(REFERENCE_GRAZING_RAD) ** 2 / math.cos(REFERENCE_GRAZING_RAD)
_LOG_REFERENCE_COUNT: Final = 150.0
_BEAM_OFFSETS: Final = np.array([-0.4, -0.2, 0.0, 0.2, 0.4])  # lines across the beam, in beam widths
_FLAT_FACET: Final = np.array([0.25, 0.75])  # where along a facet its energy is put; a steep one spans several bins
_STEEP_FACET: Final = np.array([0.125, 0.375, 0.625, 0.875])
_TEXTURE_CELLS: Final = 512


class Solid(NamedTuple):
    """An object in the plane of the scene."""

    kind: ObjectKind
    east_m: float
    north_m: float
    direction_rad: float
    length_m: float
    width_m: float
    height_m: float
    gain: float

    @property
    def reach_m(self) -> float:
        return 0.5 * math.hypot(self.length_m, self.width_m)


class Pose(NamedTuple):
    time_s: float
    east_m: float
    north_m: float
    direction_rad: float
    altitude_m: float


def mean_intensity(scene: SyntheticScene, solids: Sequence[Solid], texture: Floats | None, pose: Pose, side: float) -> Floats:
    """Expected echo intensity of the sea floor per slant-range bin, (n_samples,), before speckle and noise; side: -1 port, 1 starboard.

    Unit: the mean of a flat sea floor at 15 degrees grazing is 1.
    """
    spacing = scene.range_m / scene.n_samples
    tangent = math.tan(math.radians(scene.pitch_deg))
    slant_factor = 1.0 / math.cos(math.radians(scene.pitch_deg))
    altitude = pose.altitude_m
    cell = 0.5 * spacing
    n_cells = math.ceil(math.sqrt(scene.range_m**2 - (altitude * slant_factor) ** 2) / cell) + 2
    y = np.arange(n_cells + 1, dtype=np.float64) * cell
    flat_range: Floats = np.sqrt(y * y + (altitude * slant_factor) ** 2)
    drift = scene.speed_mps / scene.sound_speed_mps  # forward travel per metre of slant range
    ahead = (math.sin(pose.direction_rad), math.cos(pose.direction_rad))
    abeam = (side * ahead[1], -side * ahead[0])

    def position(forward: Floats, across: Floats) -> tuple[Floats, Floats]:
        east = pose.east_m + forward * ahead[0] + across * abeam[0]
        north = pose.north_m + forward * ahead[1] + across * abeam[1]
        return east, north

    beam = math.radians(scene.beam_width_deg)
    near: list[Solid] = []
    points: list[tuple[float, float]] = []
    for solid in solids:
        east, north = solid.east_m - pose.east_m, solid.north_m - pose.north_m
        forward = east * ahead[0] + north * ahead[1]
        across = east * abeam[0] + north * abeam[1]
        slant = math.hypot(across, altitude * slant_factor)
        miss = forward - altitude * tangent - slant * drift
        if solid.kind == "point":
            width = max(slant * beam, scene.speed_mps / scene.ping_rate_hz)
            if across > 0.0:
                points.append((slant, solid.gain * math.exp(-4.0 * math.log(2.0) * (miss / width) ** 2)))
        elif abs(miss) <= solid.reach_m + 0.5 * beam * slant + solid.height_m * abs(tangent) + 1e-6 and across > -solid.reach_m:
            near.append(solid)

    offsets = _BEAM_OFFSETS if near else np.zeros(1)
    fractions = _STEEP_FACET if near else _FLAT_FACET
    energy = np.zeros(scene.n_samples + 4)
    for offset in offsets:
        ground = position(altitude * tangent + flat_range * (drift + offset * beam), y)
        height = np.zeros_like(y)
        gain = np.ones_like(y)
        if near:
            for _ in range(2 if tangent else 1):  # the tilted fan meets higher ground nearer to the vehicle: iterate once
                line = (ground[0] - height * tangent * ahead[0], ground[1] - height * tangent * ahead[1])
                height = np.zeros_like(y)
                gain = np.ones_like(y)
                for solid in near:
                    _raise(height, gain, solid, *line)
        if texture is not None:
            gain = np.where(height > 0.0, gain, _texture_at(texture, scene.texture_m, *ground))
        _deposit(energy, height, gain, y, altitude, slant_factor, spacing, fractions)
    energy = energy[1 : scene.n_samples + 1] / (len(offsets) * spacing * _REFERENCE_INTENSITY)
    for slant, intensity in points:
        at = slant / spacing - 0.5
        low = math.floor(at)
        for index, share in ((low, low + 1 - at), (low + 1, at - low)):
            if 0 <= index < scene.n_samples:
                energy[index] += intensity * share
    return energy


def _raise(height: Floats, gain: Floats, solid: Solid, east: Floats, north: Floats) -> None:
    """Put one solid onto a height profile; where it rules, `gain` is its material."""
    sine, cosine = math.sin(solid.direction_rad), math.cos(solid.direction_rad)
    along = ((east - solid.east_m) * sine + (north - solid.north_m) * cosine) / (0.5 * solid.length_m)
    across = ((east - solid.east_m) * cosine - (north - solid.north_m) * sine) / (0.5 * solid.width_m)
    if solid.kind == "box":
        top = np.where((np.abs(along) <= 1.0) & (np.abs(across) <= 1.0), solid.height_m, 0.0)
    elif solid.kind == "cylinder":
        inside = (np.abs(along) <= 1.0) & (np.abs(across) <= 1.0)
        top = np.where(inside, 0.5 * solid.height_m * (1.0 + np.sqrt(np.maximum(0.0, 1.0 - across**2))), 0.0)
    else:
        bulge = 1.0 - along**2 - across**2
        root = np.sqrt(np.maximum(0.0, bulge))
        top = np.where(bulge > 0.0, solid.height_m * root if solid.kind == "rock" else 0.5 * solid.height_m * (1.0 + root), 0.0)
    rules = top > height
    height[rules] = top[rules]
    gain[rules] = solid.gain


def _deposit(
    energy: Floats, height: Floats, gain: Floats, y: Floats, altitude_m: float, slant_factor: float, spacing_m: float, fractions: Floats
) -> None:
    """Add what the facets between profile points send back to the slant-range bins.

    Bin i is energy[i + 1]; element 0 and the last three take what falls outside.
    """
    depth = altitude_m - height
    depression = depth[1:] / y[1:]
    nearest = np.minimum.accumulate(depression)
    visible = np.ones(depression.shape[0], dtype=np.bool_)
    visible[1:] = depression[1:] < nearest[:-1]
    cell = y[1] - y[0]
    slope = (height[1:] - height[:-1]) / cell
    middle_y, middle_depth = 0.5 * (y[1:] + y[:-1]), 0.5 * (depth[1:] + depth[:-1])
    stretch = np.sqrt(1.0 + slope * slope)
    sine = (middle_depth * slant_factor + middle_y * slope) / (np.hypot(middle_y, middle_depth * slant_factor) * stretch)
    material = np.where(height[1:] > 0.0, gain[1:], np.where(height[:-1] > 0.0, gain[:-1], gain[1:]))
    sent = np.where(visible & (sine > 0.0), material * sine * sine * stretch * cell, 0.0) / fractions.shape[0]
    slant = np.hypot(y, depth * slant_factor) / spacing_m + 0.5  # bin centres at whole numbers, bin 0 at 1
    n_bins = energy.shape[0]
    for fraction in fractions:
        at = slant[:-1] + fraction * (slant[1:] - slant[:-1])
        low = at.astype(np.int64)
        share = at - low
        np.clip(low, 0, n_bins - 2, out=low)
        energy += np.bincount(low, sent * (1.0 - share), n_bins)[:n_bins]
        energy += np.bincount(low + 1, sent * share, n_bins)[:n_bins]


def seabed_texture(scene: SyntheticScene) -> Floats | None:
    """Gamma-distributed cells of unit mean that repeat every 512; None for an even sea floor."""
    if scene.texture_nu == 0.0:
        return None
    random = np.random.Generator(np.random.PCG64(scene.seed))
    cells: Floats = random.gamma(scene.texture_nu, 1.0 / scene.texture_nu, (_TEXTURE_CELLS, _TEXTURE_CELLS))
    return cells


def _texture_at(texture: Floats, cell_m: float, east: Floats, north: Floats) -> Floats:
    row = np.floor(east / cell_m).astype(np.int64) % _TEXTURE_CELLS
    column = np.floor(north / cell_m).astype(np.int64) % _TEXTURE_CELLS
    values: Floats = texture[row, column]
    return values


def speckled(scene: SyntheticScene, mean: Floats, random: np.random.Generator) -> Floats:
    """Intensity per bin with noise and speckle. Echo and noise are both complex Gaussian, so their powers add under one speckle."""
    noise = 10.0 ** (scene.noise_db / 10.0)
    return np.asarray((mean + noise) * _speckle(scene, mean.shape[0], random), dtype=np.float64)


def _speckle(scene: SyntheticScene, n_samples: int, random: np.random.Generator) -> Floats:
    """Unit-mean intensity of `looks` averaged complex Gaussian fields, correlated along range by a Gaussian point-spread function."""
    if scene.psf_sigma_samples == 0.0:
        return np.asarray(random.gamma(scene.looks, 1.0 / scene.looks, n_samples), dtype=np.float64)
    reach = math.ceil(4.0 * scene.psf_sigma_samples)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / scene.psf_sigma_samples) ** 2)
    kernel /= math.sqrt(2.0 * scene.looks * float(np.dot(kernel, kernel)))
    total = np.zeros(n_samples)
    for field in random.standard_normal((2 * scene.looks, n_samples + 2 * reach)):
        total += np.convolve(field, kernel, mode="valid") ** 2
    return total


def recorded(scene: SyntheticScene, intensity: Floats) -> EchoTrace:
    spacing = scene.range_m / scene.n_samples
    ringing = (np.arange(scene.n_samples) + 0.5) * spacing < scene.ring_down_m
    samples: NDArray[Any]
    if scene.samples == "log_uint8":
        with np.errstate(divide="ignore"):
            counts = np.rint(_LOG_REFERENCE_COUNT + 10.0 * np.log10(intensity) / scene.db_per_count)
        samples = np.clip(np.where(ringing, 255.0, counts), 0.0, 255.0).astype(np.uint8)
    else:
        amplitude = np.minimum(np.where(ringing, np.inf, scene.seabed_counts * np.sqrt(intensity)), scene.full_scale)
        samples = np.rint(amplitude).astype(np.uint16) if scene.samples == "amplitude_uint16" else amplitude.astype(np.float32)
    return EchoTrace(samples=samples, first_range_m=0.5 * spacing, spacing_m=spacing)
