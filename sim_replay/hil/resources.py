"""Watch what the processes of the service hold over a run: memory, open files, pings that wait, and what grows."""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import AuvMcmError
from auv_mcm.shell.health.files import read_health

_WARM: Final = 1.0 / 3.0  # share of each start in which caches fill, of which no growth is measured
_LONG: Final = 0.5  # share of the longest start that others must have to count: caches fill in the first minutes
_BLOCKS: Final = 8  # of the rest of each start, whose medians are one value each: memory is used for moments
_MIN_SAMPLES: Final = 2 * _BLOCKS  # of a start of which growth is measured
_BYTES_PER_MB: Final = 1e6  # bytes per megabyte
_S_PER_HOUR: Final = 3600.0  # s per hour
_STALE_PERIODS: Final = 3.0  # after which a record of health is of a service that is gone
_MEASURED: Final = (
    ("memory of the service", " MB", _BYTES_PER_MB),
    ("memory of perception", " MB", _BYTES_PER_MB),
    ("open files of the service", "", 1.0),
    ("open files of perception", "", 1.0),
)


class Sample(NamedTuple):
    """Hold what service and perception take at an instant of the run; start: the number of the start."""

    at_s: float
    start: int
    service_bytes: int
    perception_bytes: int
    service_files: int
    perception_files: int


class Slope(NamedTuple):
    """Hold a growth per unit, and half of its 95 % interval."""

    middle: float
    half: float


def sampled(pid: int, start: int, at_s: float) -> Sample | None:
    """Look at the service and its largest child, which is perception; None where one of them is gone.

    Parameters
    ----------
    pid
        Of the service.
    start
        Its number.
    at_s
        The instant.
    """
    try:
        children = [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text("ascii").split()]
        perception = max(children, key=_resident_bytes)  # the other one tracks shared memory
        both = (pid, perception)
        return Sample(at_s, start, *map(_resident_bytes, both), *map(_n_open, both))
    except (OSError, ValueError):
        return None


def pings_waiting(health: Path) -> float:
    """Read how many pings wait for perception; 0 where no service reports it."""
    with contextlib.suppress(AuvMcmError):
        newest = read_health(health)
        if time.time() - newest.utc_s <= _STALE_PERIODS * newest.period_s:
            return sum(part.values.get("queue_pings", 0.0) for part in newest.parts)
    return 0.0


def health_age_s(health: Path, written_last: Path) -> float:
    """Read how old the record of health was when a later file was written, s; NaN without either."""
    with contextlib.suppress(AuvMcmError, OSError):
        return written_last.stat().st_mtime - read_health(health).utc_s
    return math.nan


def steady(share: float, samples: Sequence[Sample]) -> tuple[str, str, bool]:
    """Judge whether nothing grows by more than a share of its median over the run.

    Returns
    -------
    tuple
        What was expected, what was found, and whether it is that.
    """
    expected = f"memory and open files of both processes grow by {share:.0%} over the run at most"
    if max(Counter(sample.start for sample in samples).values(), default=0) < _MIN_SAMPLES:
        return expected, "the run was too short to measure growth", False
    blocks = np.array(list(_medians(samples)))
    run_h = samples[-1].at_s / _S_PER_HOUR
    found, passed = [], True
    for column, (name, unit, scale) in enumerate(_MEASURED, 2):
        values = blocks[:, column] / scale
        slope = slope_of(blocks[:, 0] / _S_PER_HOUR, values, blocks[:, 1].astype(int))
        found.append(f"{name} {slope.middle:+.2f} ± {slope.half:.2f}{unit} an hour")
        passed &= (slope.middle - slope.half) * run_h <= share * float(np.median(values))
    return expected, "; ".join(found), passed


def slope_of(at: NDArray[np.float64], values: NDArray[np.float64], groups: NDArray[np.int_]) -> Slope:
    """Fit one slope to values of several groups, each with a level of its own.

    Ordinary least squares; the interval is Student's, of the residuals. All are (n,).
    """
    from scipy.stats import t  # 0.6 s

    centred_at, centred = np.array(at), np.array(values)
    for group in np.unique(groups):
        centred_at[groups == group] -= at[groups == group].mean()
        centred[groups == group] -= values[groups == group].mean()
    weight = float(centred_at @ centred_at)
    n_free = len(at) - len(np.unique(groups)) - 1
    if n_free < 1 or weight == 0.0:
        return Slope(math.nan, math.nan)
    middle = float(centred_at @ centred) / weight
    variance = float(np.sum((centred - middle * centred_at) ** 2)) / n_free
    return Slope(middle, float(t.ppf(0.975, n_free)) * math.sqrt(variance / weight))


def _medians(samples: Sequence[Sample]) -> Iterator[NDArray[np.float64]]:
    """Yield medians of the later part of each long start, in blocks."""
    longest = max(Counter(sample.start for sample in samples).values())
    for start in sorted({sample.start for sample in samples}):
        of_start = np.array([sample for sample in samples if sample.start == start], dtype=np.float64)
        if len(of_start) >= max(_MIN_SAMPLES, _LONG * longest):
            for part in np.array_split(of_start[int(len(of_start) * _WARM) :], _BLOCKS):
                yield np.median(part, axis=0)


def _resident_bytes(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


def _n_open(pid: int) -> int:
    return len(os.listdir(f"/proc/{pid}/fd"))
