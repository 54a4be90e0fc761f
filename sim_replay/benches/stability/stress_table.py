"""List the rows of every numerical stage under stress."""

from __future__ import annotations

from sim_replay.benches.stability.back_rows import back_rows
from sim_replay.benches.stability.confirmation_rows import confirmation_rows
from sim_replay.benches.stability.front_rows import front_rows
from sim_replay.benches.stability.rows import NumberRow


def every_row() -> list[NumberRow]:
    """List all rows in the order of the chain."""
    return [*front_rows(), *confirmation_rows(), *back_rows()]
