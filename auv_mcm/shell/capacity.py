"""Keep up with the pings: shed work on tiles while perception is behind, and report what slows it down."""

from __future__ import annotations

from typing import Final

from auv_mcm import kernels
from auv_mcm.records import Notice

_SHED_FROM: Final = 0.25
"""Share of the queue of pings from which on work is shed. Tiles take half a minute to come and a second to work off,
which does not fill a quarter of the queue."""
_SHED_ALL: Final = 0.5  # share of the queue from which on all but the cheapest pass is shed, chosen


def room_for_tiles(n_waiting: int, queue_pings: int) -> float:
    """Give the share of the time that work on tiles may take, 0 to 1: less than 1 while perception is behind.

    Parameters
    ----------
    n_waiting
        Pings that wait for perception.
    queue_pings
        Pings that may wait.
    """
    filled = n_waiting / queue_pings
    return 1.0 if filled <= _SHED_FROM else max((_SHED_ALL - filled) / (_SHED_ALL - _SHED_FROM), 0.0)


def work_shed(n_waiting: int) -> Notice:
    """Report that work is shed while `n_waiting` pings wait."""
    return Notice(
        code="service.work_shed",
        text=f"perception is behind, {n_waiting} pings wait: until it has caught up work on the least likely places of "
        "tiles is left out, which then earn less coverage. Set budget.duty to what this computer affords, which "
        "'auv-mcm calibrate budget' measures, or use coarser pixels. Pings with less work are counted.",
    )


def no_kernels() -> Notice:
    """Report that numpy does the work of the C kernels."""
    return Notice(
        code="service.no_kernels",
        text="numpy does the work of the C kernels, which takes some twelve times the processor time: pings may be "
        f"lost. {kernels.loaded().reason}. Install the wheel with compiled kernels that deploy/wheelhouse.sh makes.",
    )
