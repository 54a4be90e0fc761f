"""Train the verifier's network on missions of a theatre, for `auv-mcm train SPEC --all`."""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Final

import numpy as np

from auv_mcm.classify.verifier import FILE, MINE_KINDS
from auv_mcm.shell.whole_files import write_file
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.looks import LookTask
from sim_replay.fitting.theatre import Theatre
from sim_replay.fitting.verifier.mill import fly_all
from sim_replay.fitting.verifier.train import started_from, train, written_as_onnx
from sim_replay.fitting.verifier.weigh import chips_of

FIRST_SEED: Final = 64_000  # of missions that nothing else is fitted or judged on
TIMES: Final = 5
"""Times as many mines and stones as a scene has."""
N_MISSIONS: Final = 24  # or a few more: some 3,400 looks at mines over named scenes
N_PASSES: Final = 8
"""Over their chips. `bench priors --further --missions 8 --passes 8`: 24 missions find 0.75 of passes over mines at 100
false alarms per km² with objects counted, as shipped 0.67. 78 from nothing in twenty passes find 0.76."""
_MIN_LOOKS: Final = 500  # at mines, at other objects and at floor: fewer show too little of what differs; chosen


def can_train() -> bool:
    """Check whether what a network is trained and written with is installed."""
    return all(importlib.util.find_spec(name) for name in ("torch", "onnx"))


def own_network(theatre: Theatre, out: Path, farm: Farm, show: Callable[[int, int], None]) -> None:
    """Train the network that ships further, on dense missions of a theatre and its lines to train on.

    Missions flown are kept beside `out`, and are not flown again. Where mines, other objects or floor were looked at
    fewer than 500 times, nothing is written, which is said on standard error.
    """
    seeds = range(FIRST_SEED, FIRST_SEED + math.ceil(N_MISSIONS / len(theatre.flown)))
    tasks = [LookTask(name, seed, TIMES, theatre=theatre) for seed in seeds for name in theatre.flown]
    tasks += [LookTask(folder, 0, theatre=theatre) for folder in theatre.lines_of("train")]
    chips = chips_of(fly_all(tasks, out.with_name("looks") / "network", farm, show))
    n_mines = np.count_nonzero(chips.label < len(MINE_KINDS))
    counts = [n_mines, *np.bincount(chips.label, minlength=len(MINE_KINDS) + 2)[len(MINE_KINDS) :]]
    if min(counts) < _MIN_LOOKS:
        seen = f"{counts[0]} mines, {counts[1]} other objects and {counts[2]} places of sea floor"
        text = f"{seen} are too few to train a network, {_MIN_LOOKS} of each are needed: the one that ships is weighed"
        print(text, file=sys.stderr)
        return
    write_file(out, written_as_onnx(train(chips, N_PASSES, start=started_from(shipped_network()))))


def shipped_network() -> bytes:
    """Read the ONNX file of the network that ships."""
    return resources.files("auv_mcm.classify").joinpath(FILE).read_bytes()
