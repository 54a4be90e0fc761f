"""Show on standard error how far a bench is."""

from __future__ import annotations

import sys
from collections.abc import Callable


def counted(total: int, what: str = "missions flown") -> Callable[[int], None]:
    """Return what shows the number done of a total over what was shown before, and ends the line with the last."""

    def show(done: int) -> None:
        print(f"\r{done} of {total} {what}", end="" if done < total else "\n", file=sys.stderr, flush=True)

    return show
