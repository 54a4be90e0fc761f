"""Lay the mines of the source paper's figures 12 and 13 in simulated scenes, and embed them in recorded lines.

The paper names three objects and states no sizes. Those here are assumed: common figures for mines of these names, for
which no published source was at hand.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import msgspec

from sim_replay.augment.targets import EmbeddedKind, ScatteredTargets, TargetSpec
from sim_replay.benches.library import with_types
from sim_replay.simulator.scene import Scene

PER_LINE: Final = 3  # of each object, embedded in a recorded line at once: the shortest line has room for no more
_APART_M: Final = 5.0  # m between embedded objects, minimum, as other benches embed them


class PaperMine(NamedTuple):
    """Name an object of the paper, with its sizes; the diameter of a cone's base or a cylinder is its width."""

    name: str
    sizes_m: dict[str, float]


MINES: Final[dict[EmbeddedKind, PaperMine]] = {
    "truncated_cone": PaperMine("Manta", {"width_m": 0.98, "height_m": 0.44}),
    "wedge": PaperMine("Rockan", {"length_m": 1.0, "width_m": 0.8, "height_m": 0.38}),
    "cylinder": PaperMine("cylinder", {"length_m": 2.0, "width_m": 0.5}),
}
"""By the kind of solid that stands for each."""


def with_mines(scene: Scene) -> Scene:
    """Lay the three objects instead of a scene's targets, as many as it has, each as its kind lies there."""
    return with_types(scene, {kind: mine.sizes_m for kind, mine in MINES.items()})


def embedded(seed: int) -> TargetSpec:
    """Draw the three objects over a recorded line, without rocks: the line's own objects are the clutter."""
    groups = []
    for kind, mine in MINES.items():
        sizes = {name: (size_m, size_m) for name, size_m in mine.sizes_m.items()}
        bare = ScatteredTargets(kinds=(kind,), count=PER_LINE, apart_m=_APART_M)
        groups.append(msgspec.structs.replace(bare, **sizes))
    return TargetSpec(seed=seed, scatter=tuple(groups))
