"""Compute the regular relief of a sea floor: ripples, ledges of rock, the canopy of seagrass."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from sim_replay.simulator.fields import FloatArray, Noise, gaussian, generator, power_law, refined_window, step_for
from sim_replay.simulator.scene import Ripples

_PERIODS: Final = (500, 567)  # nodes after which the noise repeats, along and across
# Of ripples with defects 1: the length over which crests stay in step, and the one over which their direction wanders,
# in wavelengths.
_STEP_WAVELENGTHS: Final = 2.5
_BEND_WAVELENGTHS: Final = 6.0
# Against the mean square of that field: where it is far below, ripples are low.
_VANISHING: Final = 0.15
# Of outcrops: a stratum against the relief's root mean square, its dip, and how much of the way from ledge to ledge the
# steps take.
_SURFACE_EXPONENT: Final = 4.2
_STRATUM_SHARE: Final = 1.0
_DIP_DEG: Final = (4.0, 10.0)
_RISER: Final = 0.2
_UNCUT: Final = 0.35
# Of seagrass: spread and limit of the log-normal heights, and the root mean square that is left of them.
_CANOPY_SIGMA: Final = 1.0
_CANOPY_LIMIT: Final = 1.4
_CANOPY_RMS: Final = 0.44


class RippleTrain:
    """Return the height of ripples at any place.

    A wave with crests across one direction is multiplied by a complex field of low wavenumbers, as in speckle: its
    phase bends the crests, its zeros are where crests end or fork, and around them ripples are low.
    """

    def __init__(self, ripples: Ripples, seed: int, name: str, *, cell_m: float) -> None:
        direction = math.radians(ripples.direction_deg)
        self._north_per_cell = math.cos(direction) * cell_m / ripples.wavelength_m
        self._east_per_cell = math.sin(direction) * cell_m / ripples.wavelength_m
        self._skew = np.float32(0.9 * ripples.skew)
        phase = np.linspace(0.0, 2.0 * math.pi, 3601)
        profile = np.sin(phase) * (1.0 - self._skew * np.cos(phase))
        self._gain = np.float32(ripples.height_m / np.ptp(profile))
        in_step_m = _STEP_WAVELENGTHS * ripples.wavelength_m
        self._step = step_for(in_step_m / 3.0, cell_m)
        coherent, broken = (1.0 - ripples.defects), 1.3 * ripples.defects
        whole = math.hypot(coherent, broken)
        self._coherent, self._broken = np.float32(coherent / whole), np.float32(math.sqrt(0.5) * broken / whole)
        self._bend = np.float32(2.0 * math.pi * ripples.defects)
        self._envelope: tuple[Noise, ...] = ()
        if ripples.defects > 0.0:
            self._envelope = tuple(
                Noise(
                    seed,
                    f"{name} {part}",
                    step=self._step,
                    cell_m=cell_m,
                    spectrum=gaussian(length_m),
                    periods=_PERIODS,
                )
                for part, length_m in (
                    ("real", in_step_m),
                    ("imaginary", in_step_m),
                    ("bend", _BEND_WAVELENGTHS * ripples.wavelength_m),
                )
            )

    def on_cells(self, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray:
        """Return heights in m, mean about 0, on nodes from (row, column) on: (n_rows, n_columns) float32."""
        row_phase = _phase(row, n_rows, self._north_per_cell)
        column_phase = _phase(column, n_columns, self._east_per_cell)
        row_cosine, row_sine = np.cos(row_phase)[:, None], np.sin(row_phase)[:, None]
        column_cosine, column_sine = np.cos(column_phase), np.sin(column_phase)
        if not self._envelope:
            cosine = row_cosine * column_cosine - row_sine * column_sine
            sine = row_sine * column_cosine + row_cosine * column_sine
        else:
            real, imaginary = refined_window(self._bent_envelope, self._step, row, column, n_rows, n_columns)
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

    def _bent_envelope(self, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray:
        """Return the complex field's real and imaginary part on nodes from (row, column) on: (2, n_rows, n_columns)
        float32."""
        real, imaginary, bend = (part.window(row, column, n_rows, n_columns) for part in self._envelope)
        bend *= self._bend
        cosine, sine = np.cos(bend), np.sin(bend)
        real, imaginary = self._coherent + self._broken * real, self._broken * imaginary
        # Ripples keep their height but where the field nearly vanishes.
        height = np.sqrt(np.float32(1.0 + _VANISHING) / (real * real + imaginary * imaginary + np.float32(_VANISHING)))
        return np.stack([(real * cosine - imaginary * sine) * height, (real * sine + imaginary * cosine) * height])


def _phase(first: int, n_nodes: int, turns_per_cell: float) -> FloatArray:
    """Return the phase of an undisturbed wave along one side of a window, rad."""
    phase: FloatArray = (2.0 * math.pi * np.mod((first + np.arange(n_nodes)) * turns_per_cell, 1.0)).astype(np.float32)
    return phase


class Ledges:
    """Shape broken edges of tilted strata: a fractal surface, cut into steps along parallel planes."""

    def __init__(self, rms_m: float, outer_m: float, seed: int, name: str, *, cell_m: float, step: int) -> None:
        self._step = step
        self._rms = np.float32(rms_m)
        self._thickness = _STRATUM_SHARE * rms_m
        random = generator(seed, f"{name} strata")
        strike, dip = random.uniform(0.0, 2.0 * math.pi), math.tan(math.radians(random.uniform(*_DIP_DEG)))
        self._dip_north, self._dip_east = dip * math.cos(strike) * cell_m, dip * math.sin(strike) * cell_m
        self._surface = Noise(
            seed,
            f"{name} surface",
            step=step,
            cell_m=cell_m,
            spectrum=power_law(outer_m, _SURFACE_EXPONENT),
            periods=_PERIODS,
            splined=step > 1,
        )

    def on_cells(self, row: int, column: int, grain: FloatArray) -> FloatArray:
        """Return heights in m on nodes from (row, column) on: float32 of `grain`'s shape.

        Grain roughens edges and faces.
        """
        n_rows, n_columns = grain.shape
        height = self._surface.on_cells(row, column, n_rows, n_columns)
        height += np.float32(1.0)
        height *= self._rms
        height += grain
        uncut = height.copy()
        # A whole stratum more or less changes nothing, so the planes' height needs to be known but for that.
        row_plane = np.mod((row + np.arange(n_rows)) * self._dip_north, self._thickness).astype(np.float32)[:, None]
        column_plane = np.mod((column + np.arange(n_columns)) * self._dip_east, self._thickness).astype(np.float32)
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
        # Treads keep some of the slope and roughness from before the cut.
        uncut -= height
        uncut *= np.float32(_UNCUT)
        height += uncut
        return height


class Canopy:
    """Grow clumps of seagrass with gaps between: log-normal heights that a full-grown plant limits."""

    def __init__(self, rms_m: float, outer_m: float, seed: int, name: str, *, cell_m: float, step: int) -> None:
        self._clumps = Noise(
            seed, f"{name} clumps", step=step, cell_m=cell_m, spectrum=power_law(outer_m), periods=_PERIODS
        )
        self._gain = np.float32(rms_m / _CANOPY_RMS)

    def heights(self, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray:
        """Return heights in m on nodes from (row, column) on: (n_rows, n_columns) float32."""
        height = self._clumps.window(row, column, n_rows, n_columns)
        height *= np.float32(_CANOPY_SIGMA)
        np.exp(height, out=height)
        np.minimum(height, np.float32(_CANOPY_LIMIT), out=height)
        height *= self._gain
        return height
