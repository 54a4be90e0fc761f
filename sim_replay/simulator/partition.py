"""Divide the sea floor into kinds: each kind has a fractal field, and the highest field takes the place."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sim_replay.simulator.fields import FloatArray, Noise, Spectrum, generator, refine, refined_window, step_for

# Boundaries are level lines of a surface of fractal dimension (8 - exponent) / 2 (Voss, "Random fractal forgeries",
# 1985).
_EXPONENT: Final = 3.7
_PERIODS: Final = (500, 567)
_SHARE_ROUNDS: Final = 60
_SHARE_STRIDE: Final = 4
_SLOPE_NODES: Final = 128
_FRINGE: Final = 0.25


def _spectrum(patch_m: float, longest_m: float = math.inf) -> Spectrum:
    """Fall as K^-exponent above the wavenumber of one patch and one gap, and to 0 below it, so that shares even out
    soon."""
    corner, lowest = math.pi / patch_m, 2.0 * math.pi / longest_m

    def spectrum(wavenumber: NDArray[np.float64]) -> NDArray[np.float64]:
        ratio = (wavenumber / corner) ** 2
        return np.where(wavenumber >= lowest, ratio * (1.0 + ratio) ** (-0.5 * _EXPONENT - 1.0), 0.0)

    return spectrum


def _rms_below(patch_m: float, longest_m: float) -> float:
    """Return the root mean square of wavelengths below longest_m, the whole spectrum being 1: the integral of W(K) K
    dK."""
    a, t = 0.5 * _EXPONENT + 1.0, 1.0 + (2.0 * patch_m / longest_m) ** 2
    whole = 1.0 / (a - 2.0) - 1.0 / (a - 1.0)
    return math.sqrt((t ** (2.0 - a) / (a - 2.0) - t ** (1.0 - a) / (a - 1.0)) / whole)


class Partition:
    """Compute the fields of all kinds on nodes every `step` cells."""

    def __init__(self, shares: tuple[float, ...], patch_m: float, *, seed: int, step: int, cell_m: float) -> None:
        # The more kinds, the smaller the piece in which one of them is highest.
        patch_m *= math.sqrt(0.5 * len(shares))
        wide = max(step, step_for(patch_m / 20.0, cell_m))
        self._factor = wide // step
        self._patches = Noise(
            seed, "partition", step=wide, cell_m=cell_m, spectrum=_spectrum(patch_m), periods=_PERIODS, splined=True
        )
        self._bays, self._bays_rms = None, np.float32(0.0)
        if self._factor > 1:
            longest_m = 2.0 * wide * cell_m
            self._bays = Noise(
                seed,
                "partition bays",
                step=step,
                cell_m=cell_m,
                spectrum=_spectrum(patch_m, longest_m),
                periods=_PERIODS,
            )
            self._bays_rms = np.float32(_rms_below(patch_m, longest_m))
        self._fringes = None
        if step > 1:
            spectrum = _spectrum(patch_m, 2.0 * step * cell_m)
            self._fringes = Noise(seed, "partition fringes", step=1, cell_m=cell_m, spectrum=spectrum, periods=_PERIODS)
        # One set of noise serves all kinds: far apart in it they have nothing in common.
        self._offsets = generator(seed, "partition offsets").integers(0, _PERIODS[0] * _PERIODS[1], (len(shares), 2))
        self._bias = self._solve_bias(np.array(shares) / sum(shares))
        near = self.fields(0, 0, _SLOPE_NODES, _SLOPE_NODES)
        self._per_node = np.float32(math.sqrt(0.125) / np.std(np.diff(near, axis=1)))

    def _solve_bias(self, shares: NDArray[np.float64]) -> FloatArray:
        """Solve for the offset of each kind's field that gives its share of a square of one period around the
        origin."""
        size = _PERIODS[0]
        height = np.stack(
            [
                refine(
                    self._patches.window(int(row) - size // 2, int(column) - size // 2, size, size),
                    1,
                    size - 3,
                    size - 3,
                )
                for row, column in self._offsets
            ],
            axis=-1,
        )[::_SHARE_STRIDE, ::_SHARE_STRIDE].reshape(-1, len(shares))
        bias = np.zeros(len(shares))
        for _ in range(_SHARE_ROUNDS):
            found = np.bincount(np.argmax(height + bias, axis=1), minlength=len(shares)) / len(height)
            bias += 0.5 * np.log(shares / np.maximum(found, 1e-4))
            bias -= bias.mean()
        return bias.astype(np.float32)

    def fields(self, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray:
        """Return each kind's field on nodes from (row, column) on: (kinds, n_rows, n_columns) float32."""
        out = np.empty((len(self._bias), n_rows, n_columns), dtype=np.float32)
        for kind, (down, right) in enumerate(self._offsets.tolist()):
            shifted = row + down * self._factor, column + right * self._factor
            out[kind] = refined_window(self._patches.window, self._factor, *shifted, n_rows, n_columns)
            if self._bays is not None:
                out[kind] += self._bays_rms * self._bays.window(row + down, column + right, n_rows, n_columns)
            out[kind] += self._bias[kind]
        return out

    def weights(self, fields: FloatArray) -> FloatArray:
        """Return each kind's weight at nodes: 1 and 0 but at boundaries, where it changes within about a node.

        Returns The same shape, float32; the sum over kinds is 1.

        Parameters
        ----------
        fields
            (kinds, rows, columns) as from `fields`.
        """
        first = fields.max(axis=0)
        second = np.where(fields == first, -np.inf, fields).max(axis=0)
        # Every kind's lead over the best of the others.
        weights: FloatArray = fields - np.where(fields == first, second, first)
        weights *= self._per_node
        weights += np.float32(0.5)
        np.clip(weights, 0.0, 1.0, out=weights)
        weights /= weights.sum(axis=0)
        return weights

    def fringe(self, kind: int, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray | None:
        """Compute the factor on the weight of a kind that frays its boundaries.

        It works below the nodes' spacing, on cells from (row, column) on; none if nodes are cells. (n_rows, n_columns)
        float32.
        """
        if self._fringes is None:
            return None
        down, right = self._offsets[kind].tolist()
        fringe = self._fringes.window(row + down, column + right, n_rows, n_columns)
        fringe *= np.float32(_FRINGE)
        fringe += np.float32(1.0)
        return np.maximum(fringe, np.float32(0.1), out=fringe)
