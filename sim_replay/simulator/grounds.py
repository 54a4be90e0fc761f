"""Relief and texture of one kind of sea floor, square patch by square patch, as if it were everywhere."""

from __future__ import annotations

from typing import Final

import numpy as np

from sim_replay.simulator.bedforms import Canopy, Ledges, RippleTrain
from sim_replay.simulator.fields import FloatArray, GammaLaw, Noise, gaussian, power_law, refine, step_for
from sim_replay.simulator.seabeds import Cover

_GRAIN_PERIODS: Final = (729, 800)
_TEXTURE_PERIODS: Final = (441, 500)
# Outer scale of what roughens rock and leaves, and its share of their relief.
_FACE_OUTER_M: Final = 0.4
_FACE_SHARE: Final = 0.08


class Ground:
    """What one cover looks like.

    Args:
        cover: which.
        seed, name: of its random fields.
        cell_m: distance between nodes.
        patch_cells: cells per side of a patch; results have one node more.
        step: cells between the coarse nodes of `canopy`.
    """

    def __init__(self, cover: Cover, seed: int, name: str, *, cell_m: float, patch_cells: int, step: int) -> None:
        self._patch_cells = patch_cells
        rms = cover.relief_rms_m
        self._ledges = self._canopy = self._grain = self._ripples = self._texture = None
        grain_outer_m, grain_rms = cover.relief_outer_m, rms
        if cover.type in ("rock_outcrop", "seagrass"):
            grain_outer_m, grain_rms = _FACE_OUTER_M, _FACE_SHARE * rms
        if rms > 0.0:
            self._grain = Noise(seed, f"{name} grain", step=1, cell_m=cell_m, spectrum=power_law(grain_outer_m), periods=_GRAIN_PERIODS)
            self._grain_rms = np.float32(grain_rms)
            if cover.type == "rock_outcrop":
                self._ledges = Ledges(rms, cover.relief_outer_m, seed, name, cell_m=cell_m, patch_cells=patch_cells, step=step)
            elif cover.type == "seagrass":
                self._canopy = Canopy(rms, cover.relief_outer_m, seed, name, cell_m=cell_m, step=step)
        if cover.ripples is not None:
            self._ripples = RippleTrain(cover.ripples, seed, f"{name} ripples", cell_m=cell_m, patch_cells=patch_cells)
        if cover.texture_shape > 0.0:
            self._texture_step = step_for(cover.texture_m / 2.5, cell_m, patch_cells)
            self._texture = Noise(
                seed,
                f"{name} texture",
                step=self._texture_step,
                cell_m=cell_m,
                spectrum=gaussian(cover.texture_m),
                periods=_TEXTURE_PERIODS,
                splined=True,
            )
            self._texture_law = GammaLaw(cover.texture_shape)

    def canopy(self, row: int, column: int, n_rows: int, n_columns: int) -> FloatArray | None:
        """Height in m of what is smooth at the scale of coarse nodes, on those from (row, column) on: (n_rows, n_columns) float32."""
        return None if self._canopy is None else self._canopy.heights(row, column, n_rows, n_columns)

    def relief(self, patch_row: int, patch_column: int) -> FloatArray:
        """Height in m of everything else: (patch_cells + 1, patch_cells + 1) float32."""
        nodes = self._patch_cells + 1
        if self._grain is None:
            height = np.zeros((nodes, nodes), dtype=np.float32)
        else:
            height = self._grain.window(patch_row * self._patch_cells, patch_column * self._patch_cells, nodes, nodes)
            height *= self._grain_rms
        if self._ledges is not None:
            height = self._ledges.on_patch(patch_row, patch_column, height)
        if self._ripples is not None:
            height += self._ripples.on_patch(patch_row, patch_column)
        return height

    def texture(self, patch_row: int, patch_column: int) -> FloatArray | None:
        """Factor on backscattered intensity, mean 1: (patch_cells + 1, patch_cells + 1) float32; none if it is 1 everywhere."""
        if self._texture is None:
            return None
        groups, nodes = self._patch_cells // self._texture_step, self._patch_cells + 1
        normal = self._texture.window(patch_row * groups - 1, patch_column * groups - 1, groups + 4, groups + 4)
        return self._texture_law(refine(normal, self._texture_step, nodes, nodes))
