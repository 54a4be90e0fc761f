"""Heights of what is regular on a sea floor: ripples, ledges of rock, the canopy of seagrass."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from sim_replay.simulator.fields import FloatArray, Noise, gaussian, generator, power_law, refine, step_for
from sim_replay.simulator.scene import Ripples

_PERIODS: Final = (500, 567)
# Of ripples with defects 1: the length over which crests stay in step, and the one over which their direction wanders, in wavelengths.
_STEP_WAVELENGTHS: Final = 2.5
_BEND_WAVELENGTHS: Final = 6.0
# Of outcrops: a stratum against the relief's root mean square, its dip, and how much of the way from ledge to ledge the steps take.
_STRATUM_SHARE: Final = 0.9
_DIP_DEG: Final = (3.0, 8.0)
_RISER: Final = 0.15
# Of seagrass: spread and limit of the log-normal heights, and the root mean square that is left of them.
_CANOPY_SIGMA: Final = 1.0
_CANOPY_LIMIT: Final = 2.2
_CANOPY_RMS: Final = 0.7


class RippleTrain:
    """Height of ripples, square patch by square patch.

    A wave with crests across one direction is multiplied by a complex field of low wavenumbers, as in speckle: its phase bends the crests,
    its zeros are where crests end or fork, and around them ripples are low.

    Args:
        ripples: their shape.
        seed, name: which of all ripples.
        cell_m: distance between nodes.
        patch_cells: cells per side of a patch.
    """

    def __init__(self, ripples: Ripples, seed: int, name: str, *, cell_m: float, patch_cells: int) -> None:
        self._patch_cells = patch_cells
        direction = math.radians(ripples.direction_deg)
        self._north_per_cell = math.cos(direction) * cell_m / ripples.wavelength_m
        self._east_per_cell = math.sin(direction) * cell_m / ripples.wavelength_m
        self._skew = np.float32(0.9 * ripples.skew)
        phase = np.linspace(0.0, 2.0 * math.pi, 3601)
        profile = np.sin(phase) * (1.0 - self._skew * np.cos(phase))
        self._gain = np.float32(ripples.height_m / np.ptp(profile))
        in_step_m = _STEP_WAVELENGTHS * ripples.wavelength_m
        self._step = step_for(in_step_m / 3.0, cell_m, patch_cells)
        coherent, broken = (1.0 - ripples.defects), 1.3 * ripples.defects
        whole = math.hypot(coherent, broken)
        self._coherent, self._broken = np.float32(coherent / whole), np.float32(math.sqrt(0.5) * broken / whole)
        self._bend = np.float32(2.0 * math.pi * ripples.defects)
        self._envelope: tuple[Noise, Noise, Noise] | None = None
        if ripples.defects > 0.0:
            real, imaginary, bend = (
                Noise(seed, f"{name} {part}", step=self._step, cell_m=cell_m, spectrum=gaussian(length_m), periods=_PERIODS)
                for part, length_m in (
                    ("real", in_step_m),
                    ("imaginary", in_step_m),
                    ("bend", _BEND_WAVELENGTHS * ripples.wavelength_m),
                )
            )
            self._envelope = (real, imaginary, bend)

    def on_patch(self, patch_row: int, patch_column: int) -> FloatArray:
        """Heights in m, mean about 0: (patch_cells + 1, patch_cells + 1) float32."""
        nodes = self._patch_cells + 1
        row_phase = self._phase(patch_row, self._north_per_cell)
        column_phase = self._phase(patch_column, self._east_per_cell)
        row_cosine, row_sine = np.cos(row_phase)[:, None], np.sin(row_phase)[:, None]
        column_cosine, column_sine = np.cos(column_phase), np.sin(column_phase)
        if self._envelope is None:
            cosine = row_cosine * column_cosine - row_sine * column_sine
            sine = row_sine * column_cosine + row_cosine * column_sine
        else:
            groups = self._patch_cells // self._step
            window = (patch_row * groups - 1, patch_column * groups - 1, groups + 4, groups + 4)
            real, imaginary, bend = (part.window(*window) for part in self._envelope)
            bend *= self._bend
            bend_cosine, bend_sine = np.cos(bend), np.sin(bend)
            real, imaginary = self._coherent + self._broken * real, self._broken * imaginary
            real, imaginary = real * bend_cosine - imaginary * bend_sine, real * bend_sine + imaginary * bend_cosine
            real, imaginary = refine(real, self._step, nodes, nodes), refine(imaginary, self._step, nodes, nodes)
            level = real * real
            level += imaginary * imaginary
            # Ripples keep their height but where the field nearly vanishes.
            level += np.float32(0.15)
            np.sqrt(level, out=level)
            np.divide(np.float32(math.sqrt(1.15)), level, out=level)
            real *= level
            imaginary *= level
            turned = real * column_cosine
            turned -= imaginary * column_sine
            imaginary *= column_cosine
            imaginary += real * column_sine
            cosine = turned * row_cosine
            cosine -= imaginary * row_sine
            imaginary *= row_cosine
            turned *= row_sine
            imaginary += turned
            sine = imaginary
        # -sin(phase) falls ahead of the crest; the second harmonic makes that side the steep one.
        cosine *= self._skew
        cosine += np.float32(1.0)
        height: FloatArray = sine * cosine
        height *= -self._gain
        return height

    def _phase(self, patch: int, turns_per_cell: float) -> FloatArray:
        """Phase of the undisturbed wave along one side of a patch, rad."""
        node = patch * self._patch_cells + np.arange(self._patch_cells + 1)
        phase: FloatArray = (2.0 * math.pi * np.mod(node * turns_per_cell, 1.0)).astype(np.float32)
        return phase


class Ledges:
    """Broken edges of tilted strata: a fractal surface, cut into steps along parallel planes.

    Args:
        rms_m, outer_m: of the surface.
        seed, name: which of all outcrops; the strata's strike and dip come from them.
        cell_m: distance between nodes.
        patch_cells: cells per side of a patch.
        step: cells between the nodes of the uncut surface.
    """

    def __init__(self, rms_m: float, outer_m: float, seed: int, name: str, *, cell_m: float, patch_cells: int, step: int) -> None:
        self._patch_cells, self._step = patch_cells, step
        self._rms = np.float32(rms_m)
        self._thickness = _STRATUM_SHARE * rms_m
        random = generator(seed, f"{name} strata")
        strike, dip = random.uniform(0.0, 2.0 * math.pi), math.tan(math.radians(random.uniform(*_DIP_DEG)))
        self._dip_north, self._dip_east = dip * math.cos(strike) * cell_m, dip * math.sin(strike) * cell_m
        self._surface = Noise(
            seed, f"{name} surface", step=step, cell_m=cell_m, spectrum=power_law(outer_m), periods=_PERIODS, splined=step > 1
        )

    def on_patch(self, patch_row: int, patch_column: int, grain: FloatArray) -> FloatArray:
        """Heights in m: (patch_cells + 1, patch_cells + 1) float32. `grain`, of the same shape, roughens edges and faces."""
        groups, nodes = self._patch_cells // self._step, self._patch_cells + 1
        surface = self._surface.window(patch_row * groups - 1, patch_column * groups - 1, groups + 4, groups + 4)
        surface += np.float32(1.0)
        surface *= self._rms
        height = refine(surface, self._step, nodes, nodes)
        height += grain
        # A whole stratum more or less changes nothing, so the planes' height needs to be known but for that.
        node = np.arange(nodes)
        row_plane = np.mod((patch_row * self._patch_cells + node) * self._dip_north, self._thickness).astype(np.float32)[:, None]
        column_plane = np.mod((patch_column * self._patch_cells + node) * self._dip_east, self._thickness).astype(np.float32)
        height += row_plane
        height += column_plane
        height *= np.float32(1.0 / self._thickness)
        tread = np.floor(height)
        height -= tread
        height -= np.float32(1.0 - _RISER)
        np.maximum(height, np.float32(0.0), out=height)
        height *= np.float32(1.0 / _RISER)
        height += tread
        height *= np.float32(self._thickness)
        height -= row_plane
        height -= column_plane
        grain *= np.float32(0.5)
        height += grain
        return height


class Canopy:
    """Clumps of seagrass with gaps between: log-normal heights that a full-grown plant limits.

    Args:
        rms_m: of the heights.
        outer_m: size of clumps and gaps.
        seed, name: which of all meadows.
        cell_m: size of a cell.
        step: cells between nodes.
    """

    def __init__(self, rms_m: float, outer_m: float, seed: int, name: str, *, cell_m: float, step: int) -> None:
        self._clumps = Noise(seed, f"{name} clumps", step=step, cell_m=cell_m, spectrum=power_law(outer_m), periods=_PERIODS)
        self._gain = np.float32(rms_m / _CANOPY_RMS)

    def heights(self, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray:
        """Heights in m on nodes from (row, column) on: (n_rows, n_columns) float32."""
        height = self._clumps.window(row, column, n_rows, n_columns)
        height *= np.float32(_CANOPY_SIGMA)
        np.exp(height, out=height)
        np.minimum(height, np.float32(_CANOPY_LIMIT), out=height)
        height *= self._gain
        return height
