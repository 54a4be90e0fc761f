"""Put in words what was left out of a tile: by a limit, by a budget, or since it failed."""

from __future__ import annotations

from auv_mcm.budget import Allowance
from auv_mcm.defects import Defect, defect_notice
from auv_mcm.detect.detect_tile import TileDetections
from auv_mcm.records import Detection, Notice, Tile


def looks_over_budget(detection: Detection, n_over_budget: int) -> Notice:
    """Say that detections of a tile beyond the limits were not confirmed to the end."""
    return Notice(
        code="confirm.over_budget",
        text=f"{n_over_budget} detections beyond the limits of a tile were not confirmed to the end; they keep "
        "p_mine of the step before. Raise confirm.max_per_tile and confirm.max_examined_per_tile if the computer can "
        "afford it. Further ones are only counted.",
        place=f"{detection.side}, ping {detection.ping_number}",
    )


def cheapest_pass_over(tile: Tile, allowance: Allowance) -> Notice:
    """Say that a tile's cheapest pass is beyond its budget."""
    share = (
        "unknown"
        if allowance.total_us <= 0.0
        else f"{allowance.cheapest_us / allowance.total_us:.2g} times what budget.duty allows"
    )
    return Notice(
        code="budget.cheapest_pass_over",
        text=f"the cheapest pass over a tile, which is always done, costs {share} by the price list: nothing is left "
        "for the cascade and examinations. Raise budget.duty, or measure this computer with 'auv-mcm calibrate "
        "budget'. More are counted.",
        place=f"{tile.side} tile {tile.index}",
    )


def tile_limited(tile: Tile, result: TileDetections) -> Notice:
    """Say that a tile's budget ended before all its work was done."""
    cut = (
        f"before the cascade had been through {result.n_cut} of its {result.n_windows} places"
        if result.n_cut
        else "before all examinations"
    )
    return Notice(
        code="budget.tile_limited",
        text=f"a tile's budget ended {cut}; the likeliest came first, and it earns {result.covered_share:.0%} of its "
        "coverage. Raise budget.duty if the computer can afford it. Further ones are only counted.",
        place=f"{tile.side} tile {tile.index}",
    )


def candidates_over_budget(tile: Tile, result: TileDetections) -> Notice:
    """Say that candidates of a tile beyond the limit were not measured."""
    return Notice(
        code="detect.over_budget",
        text=f"{result.n_over_budget} candidates beyond the budget of a tile were not looked at (the "
        f"{len(result.detections)} best were). Raise detect.max_candidates_per_tile if the computer can afford it. "
        "Further ones are only counted.",
        place=f"{tile.side} tile {tile.index}",
    )


def confirmation_failed(detection: Detection, defect: Defect) -> Notice:
    """Say that confirmation of a detection failed."""
    text = "That detection keeps the detector's p_mine; the mission goes on."
    return defect_notice(defect, "confirmation", text, f"{detection.side}, ping {detection.ping_number}")


def early_look_failed(defect: Defect) -> Notice:
    """Say that looking at the newest rows failed."""
    text = "Contacts come when their tile is complete; the mission goes on."
    return defect_notice(defect, "the early look", text, "newest rows")
