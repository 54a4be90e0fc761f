"""Move a highlight and a shadow polygon from where they start to the best pair: coarsely, from other starts as well,
then finely.

The detector may take a glint elsewhere for the highlight, which then keeps the shadow from where it is. So the shadow
also moves alone, and a highlight starts as a strip before it. In the end either polygon may be better off without the
other.

C and numpy take the same decisions to the last bit.
"""

from __future__ import annotations

import functools
import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels import snake
from auv_mcm.kernels.signatures import call
from auv_mcm.kernels.snake_criterion import EdgeSums, Settings
from auv_mcm.kernels.snake_twin import Moved

Nodes = NDArray[np.float64]
Schedule = tuple[tuple[int, float, int], ...]

MIN_SIDE_PX: Final = 4.0  # of a box; equal in C
MIN_ROWS: Final = 3  # in which pixels must have been measured; equal in C
_NONE: Final = np.empty((0, 2))
_NO_MOVES: Final[Schedule] = ()


class Course(NamedTuple):
    """Hold schedules of `snake.move_pair`: coarse from each start, fine from the best, polish for a shadow alone."""

    coarse: Schedule
    fine: Schedule
    polish: Schedule


def descend(
    table: NDArray[np.float64], settings: Settings, course: Course, highlight: Nodes, shadow: Nodes, strip_px: float
) -> tuple[Moved, int]:
    """Find the best pair from a start, and count the moves on the way to it.

    Parameters
    ----------
    table, settings, highlight, shadow
        As `snake.move_pair` takes them.
    strip_px
        Width of the strip before a shadow.

    Raises
    ------
    ValueError
        As move_pair does.
    """
    table = np.ascontiguousarray(table, dtype=np.float64)
    n_stages, schedule = _stages(course)
    parts = snake.checked(table, schedule, highlight, shadow)
    room, n_nodes = np.zeros((2, snake.MAX_NODES, 2)), np.array([len(nodes) for nodes in parts], dtype=np.int64)
    for which, nodes in enumerate(parts):
        room[which, : len(nodes)] = nodes
    numbers, bound = np.array(settings, dtype=np.float64), np.empty(len(table))
    out, faults, moves = (
        np.empty(3 + 2 * len(EdgeSums._fields)),
        np.empty(2, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
    )
    given, left = (table, numbers, n_stages, schedule, strip_px), (*room, n_nodes, bound, out, faults, moves)
    if not call("snake_descend", table.shape[0], table.shape[1] - 1, *given, *left):
        return descend_numpy(table, settings, course, highlight, shadow, strip_px)
    snake.refuse(faults.tolist(), settings)
    return snake.moved_of(room, n_nodes.tolist(), out.tolist()), int(moves[0])


def descend_numpy(
    table: NDArray[np.float64], settings: Settings, course: Course, highlight: Nodes, shadow: Nodes, strip_px: float
) -> tuple[Moved, int]:
    """Run `descend` as a sequence of `snake.move_pair`."""

    def run(schedule: Schedule, highlight: Nodes, shadow: Nodes) -> Moved:
        return snake.move_pair(table, settings, np.array(schedule, dtype=np.float64).reshape(-1, 3), highlight, shadow)

    best = run(course.coarse, highlight, shadow)
    n_moves = best.n_moves
    if len(shadow):
        alone = run(course.coarse, _NONE, shadow)
        strip = _strip_before(alone.shadow, strip_px, table.shape[0], table.shape[1] - 1)
        if is_measured(table, strip):
            other = run(course.coarse[-1:], strip, alone.shadow)
            if other.criterion < best.criterion:
                best, n_moves = other, alone.n_moves + other.n_moves
    best = run(course.fine, best.highlight, best.shadow)
    n_moves += best.n_moves
    if len(best.highlight) and len(best.shadow):
        for lone in (run(course.polish, _NONE, best.shadow), run(_NO_MOVES, best.highlight, _NONE)):
            if lone.criterion < best.criterion:
                best, n_moves = lone, n_moves + lone.n_moves
    return best, n_moves


def box(top: float, near: float, bottom: float, far: float, n_rows: int, n_columns: int) -> Nodes:
    """Make a box in whole pixels within a window, at least MIN_SIDE_PX each way, (4, 2) nodes."""
    top, bottom = _interval(top, bottom, n_rows)
    near, far = _interval(near, far, n_columns)
    return np.array([(top, near), (top, far), (bottom, far), (bottom, near)])


def _interval(low: float, high: float, size: int) -> tuple[float, float]:
    low, high = float(round(min(max(low, 0.0), size))), float(round(min(max(high, 0.0), size)))
    low = max(0.0, min(low, size - MIN_SIDE_PX))
    return low, max(high, low + MIN_SIDE_PX)


def row_intervals(
    nodes: Nodes, shape: tuple[int, ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Find the rows a polygon reaches, and its columns [near, far) in each; three (n,) int64."""
    near, far = snake.sides(nodes, shape[0], shape[1])
    rows = ((near >= 0) & (far > near)).nonzero()[0]
    return rows, near[rows], far[rows]


def is_measured(table: NDArray[np.float64], nodes: Nodes) -> bool:
    """Decide whether enough pixels inside a polygon were measured.

    That is in MIN_ROWS rows, or in all that it reaches if those are fewer.
    """
    if len(nodes) == 0:
        return False
    rows, near, far = row_intervals(nodes, (table.shape[0], table.shape[1] - 1))
    n_measured = int(np.count_nonzero(table[rows, far, 1] - table[rows, near, 1] >= 1.0))
    return n_measured >= max(min(MIN_ROWS, len(rows)), 1)


def _strip_before(shadow: Nodes, width_px: float, n_rows: int, n_columns: int) -> Nodes:
    """Make a strip on the near side of a shadow; none where the window begins."""
    near = math.floor(float(np.median(np.sort(shadow[:, 1])[: max(len(shadow) // 2, 1)])))
    if near < MIN_SIDE_PX:
        return _NONE
    return box(float(shadow[:, 0].min()), near - width_px, float(shadow[:, 0].max()), near, n_rows, n_columns)


@functools.lru_cache(maxsize=8)
def _stages(course: Course) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    n_stages = np.array([len(schedule) for schedule in course], dtype=np.int64)
    schedule = np.array([stage for schedule in course for stage in schedule], dtype=np.float64).reshape(-1, 3)
    n_stages.flags.writeable = schedule.flags.writeable = False
    return n_stages, schedule
