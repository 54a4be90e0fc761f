"""Check what only the bench needs, as part of the self-check."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from auv_mcm.shell.check.finding import Finding
from sim_replay.simulator import backend
from sim_replay.simulator.speckle import gaussian_taps, row_keys, speckle_rows, speckle_rows_numpy

_NAME = "simulator kernels"


def bench_findings() -> Iterator[Finding]:
    """Compare the simulator's C kernels with numpy."""
    loaded = backend.simulator_library()
    if loaded.library is None:
        yield Finding(_NAME, "warning", f"numpy does their work, more slowly: {loaded.reason}")
        return
    energy, keys, taps = np.linspace(0.0, 2.0, 4 * 300).reshape(4, 300), row_keys(0, [0], 0, 4), gaussian_taps(1.5)
    same = np.array_equal(speckle_rows(energy, keys, taps), speckle_rows_numpy(energy, keys, taps))
    yield Finding(_NAME, "ok" if same else "FAILED", f"{loaded.reason}, {'equal to' if same else 'NOT EQUAL to'} numpy")
