"""Run one log through the chain in this process, from file to contacts on one core, and print what it cost as JSON.

The bench starts one such process per measurement: user and system time of the whole process, start-up among it, are the
cost.
"""

from __future__ import annotations

import json
import math
import os
import time
from pathlib import Path
from typing import Final

from auv_mcm import kernels
from auv_mcm.commands import Parser
from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.memory import return_large_arrays
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import CoveragePatch, Ping, PipelineEvent
from auv_mcm.settings.config import Config, parse_config
from sim_replay.logs.open_log import open_log
from sim_replay.logs.recorded import several_at_once

MODULE: Final = "sim_replay.benches.run_time.one_run"
DEFAULT: Final = "default"
"""Name of the operating point that the package ships with."""


def peak_memory_mb() -> float:
    """Read the peak memory of this program, MB; unlike ru_maxrss it has nothing of the process that started it."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024.0 for line in lines if line.startswith("VmHWM"))


def run_chain(log: Path, config: Config, contacts: Path) -> dict[str, object]:
    """Run the chain and write its contacts; returns costs and counts of work."""
    return_large_arrays()
    pipeline = Pipeline(config, timer=time.process_time)
    n_pings, n_samples, first_s, last_s, covered_m2, read_s = 0, 0, math.nan, math.nan, 0.0, 0.0
    mark = start = time.process_time()

    def area_m2(events: list[PipelineEvent]) -> float:
        return sum(event.covered_m2 for event in events if isinstance(event, CoveragePatch))

    for event in several_at_once(open_log(log, config)):
        read_s += time.process_time() - mark
        if isinstance(event, Ping):
            first_s = event.time_s if n_pings == 0 else first_s
            last_s = event.time_s
            n_pings += 1
            n_samples += sum(trace.samples.size for trace in (event.port, event.starboard) if trace is not None)
        covered_m2 += area_m2(pipeline.feed(event))
        mark = time.process_time()
    covered_m2 += area_m2(pipeline.finish())
    chain_s = time.process_time() - start
    contacts.write_bytes(contacts_geojson(pipeline.contacts))
    return {
        "chain_s": chain_s,
        "stages_s": {"read": read_s, **pipeline.costs_s},
        "sonar_s": last_s - first_s,
        "pings": n_pings,
        "samples": n_samples,
        "covered_km2": covered_m2 * 1e-6,
        "counters": dict(sorted(pipeline.counters.items())),
        "peak_memory_mb": peak_memory_mb(),
        "kernels": kernels.backend(),
    }


def main() -> int:
    """Run the chain once over a log and print costs and counts as JSON."""
    parser = Parser(prog=f"python -m {MODULE}", description=main.__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--contacts", type=Path, required=True)
    arguments = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    config = parse_config(arguments.config.read_text("utf-8"), str(arguments.config))
    print(json.dumps(run_chain(arguments.log, config, arguments.contacts)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
