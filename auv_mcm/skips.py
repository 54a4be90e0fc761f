"""Register every skip of the chain.

Work that is left out early because it cannot, or hardly can, change what is reported.

A skip has a name to switch it off with, a counter in `summary.json`, and a proof: the same bytes without it, or a bound
that docs/results.md holds the figure of. What a stage decides after it has done its work is no skip.
"""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from typing import Final, Literal, NamedTuple, TypeAlias, get_args

SkipName: TypeAlias = Literal[
    "empty-tiles",
    "contrast-bounds",
    "faint-contrasts",
    "cascade-rejection",
    "cascade-budget",
    "gate",
    "candidate-limit",
    "detector-odds",
    "look-limit",
    "look-budget",
    "verifier-odds",
    "contour-odds",
    "hopeless-solids",
]
Skips: TypeAlias = AbstractSet[SkipName]

NO_SKIPS: Final[frozenset[SkipName]] = frozenset()
ALL_SKIPS: Final[frozenset[SkipName]] = frozenset(get_args(SkipName))


class Skip(NamedTuple):
    """Describe one skip. leaves_out: which work. because: why that is no loss. counter: what counts it.

    proof: `bytes` where the contacts are the same without it whatever the mission, `bytes while 0` where they are as
    long as the counter is 0, `bound` where they may differ by as much as the bench shows.
    """

    name: SkipName
    leaves_out: str
    because: str
    counter: str
    proof: Literal["bytes", "bytes while 0", "bound"]


SKIPS: Final[tuple[Skip, ...]] = (
    Skip(
        "empty-tiles",
        "detection in tiles without a pixel to score",
        "all pixels are masked or near the nadir, where no detection can be",
        "detect.tile_skipped_nothing_to_see",
        "bytes",
    ),
    Skip(
        "contrast-bounds",
        "contrasts of pixels whose boxes cannot reach the threshold",
        "the extremes of a block's variances bound its scores in closed form",
        "detect.pixels_bounded",
        "bytes",
    ),
    Skip(
        "faint-contrasts",
        "peaks of contrast below 5.3 deviates beside the cascade",
        "without the cascade's help such a peak does not reach the lowest p_mine that is reported",
        "detect.tiles_clear_contrasts",
        "bound",
    ),
    Skip(
        "cascade-rejection",
        "comparisons of the cascade after a window has fallen below a threshold on the way",
        "the thresholds kept 98 % of the best validation targets",
        "detect.windows_rejected",
        "bound",
    ),
    Skip(
        "cascade-budget",
        "windows beyond the tile's budget, the least likely ones",
        "contrasts still serve there, and the tile earns less coverage",
        "detect.windows_cut",
        "bytes while 0",
    ),
    Skip(
        "gate",
        "measuring places that cannot become a contact that is reported",
        "the forecast of the final odds, with a margin, stays below the lowest p_mine",
        "detect.gated",
        "bound",
    ),
    Skip(
        "candidate-limit",
        "measuring places beyond the maximum per tile, the least likely ones",
        "a notice says so",
        "detect.over_budget",
        "bytes while 0",
    ),
    Skip(
        "detector-odds",
        "examinations of detections whose measurements make a mine unlikely",
        "p_mine from the detector's measurements is below confirm.min_p_mine",
        "confirm.odds_too_low",
        "bound",
    ),
    Skip(
        "look-limit",
        "confirmations and examinations beyond the maximum per tile, the least likely ones",
        "a notice says so, and the contact carries over_budget",
        "confirm.over_budget",
        "bytes while 0",
    ),
    Skip(
        "look-budget",
        "examinations beyond the tile's budget, the least likely ones",
        "the contact carries over_budget, and the tile earns less coverage",
        "confirm.beyond_budget",
        "bytes while 0",
    ),
    Skip(
        "verifier-odds",
        "contours, the Markov field and solids where the verifier makes a mine unlikely",
        "p_mine after the verifier is below 0.05 or confirm.min_p_mine",
        "confirm.ended_at_verifier",
        "bound",
    ),
    Skip(
        "contour-odds",
        "the Markov field and solids where the contours make a mine unlikely, where they decide: without a verifier",
        "p_mine after the contours is below confirm.min_p_mine",
        "confirm.ended_at_contours",
        "bound",
    ),
    Skip(
        "hopeless-solids",
        "refining solids with the beam that are far behind the best one, or all where free contours explain far more",
        "refinement gains less than 40 and 60 nats",
        "confirm.solids_not_refined",
        "bound",
    ),
)
