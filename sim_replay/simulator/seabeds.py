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


class Cover(msgspec.Struct, frozen=True, kw_only=True):
    """Describe one kind of sea floor completely.

    relief_rms_m, relief_outer_m: its own relief, a power-law spectrum up to relief_outer_m: grains and bumps, the
    ledges of an outcrop, or the canopy of seagrass. Everything else as in `scene.Seabed`.
    """

    type: SeabedType
    sediment: Sediment
    relief_rms_m: float
    relief_outer_m: float
    ripples: Ripples | None
    texture_shape: float
    texture_m: float
    stones_per_ha: float
    stone_m: float
    level_db: float = 0.0


USUAL: Final[Mapping[SeabedType, Cover]] = {
    cover.type: cover
    for cover in (
        Cover(
            type="mud",
            sediment="medium_silt",
            relief_rms_m=0.002,
            relief_outer_m=1.5,
            ripples=None,
            texture_shape=25.0,
            texture_m=2.0,
            stones_per_ha=0.0,
            stone_m=0.2,
        ),
        Cover(
            type="sand",
            sediment="fine_sand",
            relief_rms_m=0.004,
            relief_outer_m=1.0,
            ripples=None,
            texture_shape=12.0,
            texture_m=1.2,
            stones_per_ha=2.0,
            stone_m=0.2,
        ),
        Cover(
            type="rippled_sand",
            sediment="medium_sand",
            relief_rms_m=0.004,
            relief_outer_m=1.0,
            ripples=Ripples(wavelength_m=0.8, height_m=0.1, direction_deg=35.0),
            texture_shape=8.0,
            texture_m=1.0,
            stones_per_ha=2.0,
            stone_m=0.2,
        ),
        Cover(
            type="gravel",
            sediment="sandy_gravel",
            relief_rms_m=0.012,
            relief_outer_m=0.3,
            ripples=None,
            texture_shape=4.0,
            texture_m=0.5,
            stones_per_ha=150.0,
            stone_m=0.2,
        ),
        Cover(
            type="rock_outcrop",
            sediment="rock",
            relief_rms_m=0.3,
            relief_outer_m=10.0,
            ripples=None,
            texture_shape=1.5,
            texture_m=0.6,
            stones_per_ha=150.0,
            stone_m=0.3,
        ),
        Cover(
            type="boulder_field",
            sediment="cobble",
            relief_rms_m=0.02,
            relief_outer_m=0.6,
            ripples=None,
            texture_shape=3.0,
            texture_m=0.6,
            stones_per_ha=1500.0,
            stone_m=0.3,
        ),
        Cover(
            type="seagrass",
            sediment="sandy_gravel",
            relief_rms_m=0.12,
            relief_outer_m=8.0,
            ripples=None,
            texture_shape=1.5,
            texture_m=0.8,
            stones_per_ha=0.0,
            stone_m=0.2,
        ),
    )
}


def cover_of(seabed: Seabed) -> Cover:
    """Return the usual cover of the type, with the scene's keys in place of those they override."""
    given = {
        name: value
        for name in ("relief_rms_m", "ripples", "texture_shape", "texture_m", "stones_per_ha", "stone_m")
        if (value := getattr(seabed, name)) is not None
    }
    return msgspec.structs.replace(USUAL[seabed.type], level_db=seabed.level_db, **given)
