"""Measure how many evaluations of a cascade one core of this computer makes in a second."""

from __future__ import annotations

import statistics
import time
from typing import Final

import msgspec
import numpy as np

from auv_mcm.detect.cascade.codes import codes_of, make_plane
from auv_mcm.detect.cascade.model import MAX_LEAF, MAX_STUMPS, CascadeModel
from auv_mcm.detect.cascade.run import opening_groups, run_plane

_SHAPE: Final = (512, 1024)  # rows and columns of the tile that is timed
_FIRST_RETURN_M: Final = 6.0  # m, of the tile that is timed
_N_FINISHED: Final = 20_000  # windows that go all the way
_ANY_SCORE: Final = -MAX_STUMPS * MAX_LEAF


def measure_speed(model: CascadeModel, row_spacing_m: float, column_spacing_m: float, n_runs: int = 5) -> float:
    """Measure evaluations per second of one core, from codes to result: median of n_runs.

    Nothing is rejected in these runs.

    A tile where much is rejected makes fewer evaluations per second, but takes less time in all. Only survivors without
    neighbours that go all the way would take longer, up to twice; real ones hang together.
    """
    random = np.random.Generator(np.random.PCG64(1))
    intensity = random.exponential(size=_SHAPE).astype(np.float32)
    everywhere = np.ones(_SHAPE, dtype=np.bool_)
    first_return_m = np.full(_SHAPE[0], _FIRST_RETURN_M)
    endless = msgspec.structs.replace(model, reject=(_ANY_SCORE,) * len(model.reject))
    sizes = [len(group) for group in model.groups]
    first = opening_groups(model)
    budget = sum(sizes[:first]) * intensity.size + sum(sizes[first:]) * _N_FINISHED

    def speed() -> float:
        began_s = time.thread_time()
        plane = make_plane(
            codes_of(intensity, everywhere), everywhere, everywhere, first_return_m, row_spacing_m, column_spacing_m
        )
        n_evaluations = run_plane(plane, endless, budget).n_evaluations
        return n_evaluations / (time.thread_time() - began_s)

    speed()  # the first run brings code and tables into memory
    return statistics.median(speed() for _ in range(n_runs))
