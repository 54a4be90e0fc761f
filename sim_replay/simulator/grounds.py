"""Compute relief and texture of one kind of sea floor, as if it were everywhere."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from sim_replay.simulator.bedforms import Canopy, Ledges, RippleTrain
from sim_replay.simulator.fields import FloatArray, GammaLaw, Noise, gaussian, power_law, step_for
from sim_replay.simulator.scene import SeabedType
from sim_replay.simulator.seabeds import Cover

_GRAIN_PERIODS: Final = (729, 800)  # nodes after which the grain repeats, along and across
_TEXTURE_PERIODS: Final = (441, 500)  # nodes after which the texture repeats
# What roughens ledges and canopies: its outer scale, and its share of their relief.
_ROUGHENED: Final[Mapping[SeabedType, tuple[float, float]]] = {"rock_outcrop": (1.5, 0.12), "seagrass": (0.3, 0.2)}


class Ground:
    """Compute the relief and texture of one cover."""

    def __init__(self, cover: Cover, seed: int, name: str, *, cell_m: float, step: int) -> None:
        rms = cover.relief_rms_m
        self._ledges = self._canopy = self._grain = self._ripples = self._texture = None
        if rms > 0.0:
            outer_m, share = _ROUGHENED.get(cover.type, (cover.relief_outer_m, 1.0))
            self._grain = Noise(
                seed, f"{name} grain", step=1, cell_m=cell_m, spectrum=power_law(outer_m), periods=_GRAIN_PERIODS
            )
            self._grain_rms = np.float32(share * rms)
            if cover.type == "rock_outcrop":
                self._ledges = Ledges(rms, cover.relief_outer_m, seed, name, cell_m=cell_m, step=step)
            elif cover.type == "seagrass":
                self._canopy = Canopy(rms, cover.relief_outer_m, seed, name, cell_m=cell_m, step=step)
        if cover.ripples is not None:
            self._ripples = RippleTrain(cover.ripples, seed, f"{name} ripples", cell_m=cell_m)
        if cover.texture_shape > 0.0:
            self._texture = Noise(
                seed,
                f"{name} texture",
                step=step_for(cover.texture_m / 2.5, cell_m),
                cell_m=cell_m,
                spectrum=gaussian(cover.texture_m),
                periods=_TEXTURE_PERIODS,
                splined=True,
            )
            self._texture_law = GammaLaw(cover.texture_shape)

    def canopy(self, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray | None:
        """Return the height in m that is smooth at coarse nodes, on those from (row, column) on.

        (n_rows, n_columns) float32.
        """
        return None if self._canopy is None else self._canopy.heights(row, column, n_rows, n_columns)

    def relief(self, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray:
        """Return the remaining height in m, on the cells' nodes from (row, column) on: (n_rows, n_columns) float32."""
        if self._grain is None:
            height = np.zeros((n_rows, n_columns), dtype=np.float32)
        else:
            height = self._grain.window(row, column, n_rows, n_columns)
            height *= self._grain_rms
        if self._ledges is not None:
            height = self._ledges.on_cells(row, column, height)
        if self._ripples is not None:
            height += self._ripples.on_cells(row, column, n_rows, n_columns)
        return height

    def texture(self, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray | None:
        """Compute the factor on backscattered intensity, mean 1, on the cells' nodes from (row, column) on.

        (n_rows, n_columns) float32; none if it is 1 everywhere.
        """
        if self._texture is None:
            return None
        return self._texture_law(self._texture.on_cells(row, column, n_rows, n_columns))
