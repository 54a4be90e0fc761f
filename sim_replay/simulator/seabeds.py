"""Define the usual properties of each seabed type, and a scene's changes to them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Literal, TypeAlias

import msgspec

from sim_replay.simulator.scene import Ripples, Seabed, SeabedType

# Rows of APL-UW TR 9407, Sec. IV, Table 2.
Sediment: TypeAlias = Literal[
    "rough_rock",
    "rock",
    "cobble",
    "sandy_gravel",
    "coarse_sand",
    "medium_sand",
    "fine_sand",
    "very_fine_sand",
    "coarse_silt",
    "medium_silt",
    "clay",
]


class Cover(msgspec.Struct, frozen=True):
    """Describe one kind of sea floor completely.

    relief_rms_m, relief_outer_m: its own relief, a power-law spectrum up to relief_outer_m: grains and bumps, the
    ledges of an outcrop, or the canopy of seagrass. Everything else as in `scene.Seabed`.
    """

    type: SeabedType
    sediment: Sediment
    relief_rms_m: float
    relief_outer_m: float
    texture_shape: float
    texture_m: float
    stones_per_ha: float
    stone_m: float
    ripples: Ripples | None = None
    level_db: float = 0.0


# type, sediment, relief_rms_m, relief_outer_m, texture_shape, texture_m, stones_per_ha, stone_m
_USUAL: Final[tuple[tuple[SeabedType, Sediment, float, float, float, float, float, float], ...]] = (
    ("mud", "medium_silt", 0.002, 1.5, 25.0, 2.0, 0.0, 0.2),
    ("sand", "fine_sand", 0.004, 1.0, 12.0, 1.2, 2.0, 0.2),
    ("rippled_sand", "medium_sand", 0.004, 1.0, 8.0, 1.0, 2.0, 0.2),
    ("gravel", "sandy_gravel", 0.012, 0.3, 4.0, 0.5, 150.0, 0.2),
    ("rock_outcrop", "rock", 0.3, 10.0, 1.5, 0.6, 150.0, 0.3),
    ("boulder_field", "cobble", 0.02, 0.6, 3.0, 0.6, 1500.0, 0.3),
    ("seagrass", "sandy_gravel", 0.12, 8.0, 1.5, 0.8, 0.0, 0.2),
)
_RIPPLES: Final[Mapping[SeabedType, Ripples]] = {
    "rippled_sand": Ripples(wavelength_m=0.8, height_m=0.1, direction_deg=35.0)
}
USUAL: Final[Mapping[SeabedType, Cover]] = {row[0]: Cover(*row, ripples=_RIPPLES.get(row[0])) for row in _USUAL}


def cover_of(seabed: Seabed) -> Cover:
    """Return the usual cover of the type, with the scene's keys in place of those they override."""
    given = {
        name: value
        for name in ("relief_rms_m", "ripples", "texture_shape", "texture_m", "stones_per_ha", "stone_m")
        if (value := getattr(seabed, name)) is not None
    }
    return msgspec.structs.replace(USUAL[seabed.type], level_db=seabed.level_db, **given)
