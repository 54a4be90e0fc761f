"""Compare the chain with the C kernels and without: whether numpy keeps up with a sonar, and finds the same."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from sim_replay.benches.run_time.lines import BenchMission
from sim_replay.benches.run_time.measure import SettingResult, measure_settings, times_real_time
from sim_replay.benches.run_time.points import ChainSetting

WITHOUT_KERNELS: Final[Mapping[str, str]] = {"AUV_MCM_KERNELS": "numpy"}
FALLBACK_HEADER: Final = ("mission", "kernels", "times real time", "processor time", "contacts", "called", "in common")


def measure_fallback(
    default: ChainSetting, lines: Sequence[BenchMission], repeat: int, folder: Path, progress: Callable[[str], None]
) -> tuple[SettingResult, SettingResult]:
    """Run the default operating point with the kernels, then without them."""
    with_c = measure_settings([default], lines, repeat, folder, progress)
    with_numpy = measure_settings([default], lines, repeat, folder, progress, environment=WITHOUT_KERNELS)
    return with_c[0], with_numpy[0]


def fallback_rows(with_c: SettingResult, with_numpy: SettingResult) -> list[list[str]]:
    """Write two rows of text per mission. In common: places that are called either way."""
    rows = []
    for name, fast in with_c.runs.items():
        slow = with_numpy.runs[name]
        common = len(set(fast.called) & set(slow.called))
        for kernels, run in (("c", fast), ("numpy", slow)):
            ratio = min(run.chain_s) / min(fast.chain_s)
            rows.append(
                [
                    *(name, kernels, f"{times_real_time(run):.1f}", f"{min(run.chain_s):.1f} s, x {ratio:.1f}"),
                    *(f"{run.contacts}", f"{len(run.called)}", f"{common}"),
                ]
            )
    return rows
