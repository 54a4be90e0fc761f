"""Keep a mission going when the processing of one piece of it fails.

An exception from a stage is a defect of this program, or memory that ran out. Live, losing one tile is better than
losing the mission: the piece is counted, reported and not covered. Developers still see the exception: each one raises
a DefectWarning, which tests and `python -W error::ResourceWarning` turn into an error.
"""

from __future__ import annotations

import traceback
import warnings
from collections.abc import Callable
from pathlib import PurePath
from typing import NamedTuple, TypeVar

from auv_mcm.records import Notice

R = TypeVar("R")


class DefectWarning(ResourceWarning):
    """Warn that a stage failed on a piece of the mission. Python hides this category unless asked to show it."""


class Defect(NamedTuple):
    """Hold an exception raised by a stage, in words.

    text: its type, message, and where in the code it was raised.
    """

    text: str
    error: Exception


def caught(stage: Callable[[], R]) -> R | Defect:
    """Run a stage; return its result, or the defect it raised. MemoryError counts as one."""
    try:
        return stage()
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        where = f" in {PurePath(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
        return Defect(f"{type(error).__name__}: {error}{where}", error)


def defect_notice(defect: Defect, what: str, consequence: str, place: str) -> Notice:
    """Word the notice of a defect in one piece, warning developers on the way.

    Parameters
    ----------
    what
        The work that failed.
    consequence
        What follows.
    """
    warn_of(defect, f"{what} failed at {place}")
    advice = "Free memory" if isinstance(defect.error, MemoryError) else "This is a defect: report it with the log"
    return Notice(
        code="pipeline.tile_failed",
        text=f"{what} failed ({defect.text}). {consequence} {advice}. Further ones are only counted.",
        place=place,
    )


def warn_of(defect: Defect, what_failed: str) -> None:
    """Show developers a defect. Raises DefectWarning where warnings are errors."""
    try:
        warnings.warn(DefectWarning(f"{what_failed}: {defect.text}"), stacklevel=2)
    except DefectWarning as warning:
        raise warning from defect.error
