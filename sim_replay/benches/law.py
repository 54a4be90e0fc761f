"""Measure how often a recorder's law is recognised, and the error of its decibels per count.

Over simulated floors, recorders and looks.

auv-mcm bench law                       simulates, decides as a mission does, prints tables
auv-mcm bench law --log LOG ...         what recorded logs are taken for, and whether anything is doubted

Each floor is simulated once per seed and number of looks, in linear units; every recorder then stores those same echoes
in its own way. The figures in `auv_mcm/waterfall/law.py`, `decibels.py`, `even.py`,
`texture.py` and `quiet.py` were set on seeds 1 to 4 of flat, ripple, rough and seagrass: other seeds show what is new
to them, other scenes what is of another kind.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import islice, product
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import EchoTrace, Notice, Ping, Transfer
from auv_mcm.settings.config import Config, SonarConfig
from auv_mcm.waterfall.law import Law
from auv_mcm.waterfall.law_watch import LawWatch, weigh_pings
from sim_replay.arguments import count
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.logs.recorded import open_mission
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import SampleRecorder
from sim_replay.simulator.scene_file import named_scenes, read_scene
from sim_replay.text_tables import columns, markdown

FIRST_SEED: Final = 7101  # nothing here was set on seeds from here on
FLOORS: Final = ("flat", "ripple", "rough", "seagrass")
LOOKS: Final = (1, 2, 4, 8)  # of the recorders simulated
N_PINGS: Final = 512  # per stretch
WITHIN: Final = 0.15  # of decibels per count
_RINGING: Final = 6  # first samples, which clip
_LOG_SPAN_DB: Final = 100.0  # of 16-bit logarithmic recorders
_HEADROOM_DB: Final = {False: 40.0, True: 6.0}  # of logarithms above the mean floor, without and with clipping
_LEVELS: Final[dict[tuple[Law, int], tuple[float, float, float]]] = {
    # Mean floor without and with clipping, and full scale, counts: amplitude as root mean square.
    ("amplitude", 8): (35.0, 120.0, 255.0),
    ("amplitude", 16): (3000.0, 16_000.0, 32_767.0),
    ("intensity", 8): (25.0, 90.0, 255.0),
    ("intensity", 16): (2000.0, 22_000.0, 65_535.0),
}


class Store(NamedTuple):
    """Describe how a recorder stores echoes; db_per_count is None unless its law is the logarithm."""

    law: Law
    db_per_count: float | None
    bits: int
    clips: bool

    @property
    def name(self) -> str:
        """Name the law, with its decibels per count."""
        return self.law if self.db_per_count is None else f"{self.law} {self.db_per_count:g}"


_KINDS: Final[tuple[tuple[Law, float | None], ...]] = (
    ("amplitude", None),
    ("intensity", None),
    ("log", 0.2),
    ("log", 0.3),
    ("log", 0.4),
    ("log", 0.5),
)
STORES: Final = tuple(
    Store(law, db_per_count, bits, clips)
    for (law, db_per_count), bits, clips in product(_KINDS, (8, 16), (False, True))
)


class JudgedLaw(NamedTuple):
    """Hold one judged mission. decided, ended: transfer after the first verdict, and after the last ping.

    db_interval: 5 to 95 % of decibels per count from all its pings, NaN without usable samples. doubts: codes of what
    was said against the law when it was configured rightly. cpu_s: processor time of watching it with nothing
    configured.
    """

    scene: str
    seed: int
    looks: int
    store: Store
    decided: Transfer
    ended: Transfer
    db_interval: tuple[float, float]
    doubts: tuple[str, ...]
    cpu_s: float


def floor_intensity(scene_name: str, seed: int, looks: int, n_pings: int = N_PINGS) -> NDArray[np.float64]:
    """Simulate the intensity (n_pings, 2, n_samples) of the first pings of a scene.

    It is 1 where the plain floor of the scene is in mid-range.
    """
    scene = read_scene(scene_name)
    recorder = SampleRecorder(samples="amplitude_float32", seabed_counts=1.0, full_scale=65535)
    scene = msgspec.structs.replace(
        scene, seed=seed, sonar=msgspec.structs.replace(scene.sonar, looks=looks, recorder=recorder)
    )
    heard = (event for event in Mission(scene).events() if isinstance(event, Ping))
    amplitude = [
        [trace.samples for trace in (ping.port, ping.starboard) if trace is not None] for ping in islice(heard, n_pings)
    ]
    return np.square(np.array(amplitude, dtype=np.float64))


def stored(intensity: NDArray[np.float64], store: Store) -> NDArray[Any]:
    """Store intensities as counts, (n_pings, 2, n_samples)."""
    if store.db_per_count is None:
        quiet, loud, full = _LEVELS[store.law, store.bits]
        counts = (loud if store.clips else quiet) * (np.sqrt(intensity) if store.law == "amplitude" else intensity)
    else:
        full = 255.0 if store.bits == 8 else float(round(_LOG_SPAN_DB / store.db_per_count))
        # A recorder that spans little puts its floor in the middle.
        headroom_db = min(_HEADROOM_DB[store.clips], 0.45 * full * store.db_per_count)
        counts = full + (10.0 * np.log10(np.maximum(intensity, 1e-30)) - headroom_db) / store.db_per_count
    counts[..., :_RINGING] = full
    return np.rint(np.clip(counts, 0.0, full)).astype(np.uint8 if store.bits == 8 else np.uint16)


def judge_law(
    scene: str, seed: int, looks: int, store: Store, intensity: NDArray[np.float64], rate_hz: float = 14.0
) -> JudgedLaw:
    """Recognise the law of a mission of these echoes, and doubt it when configured rightly."""
    pings = [
        Ping(
            number=number,
            time_s=1.7e9 + number / rate_hz,
            port=EchoTrace(samples=port, first_range_m=0.025, spacing_m=0.05),
            starboard=EchoTrace(samples=starboard, first_range_m=0.025, spacing_m=0.05),
        )
        for number, (port, starboard) in enumerate(stored(intensity, store))
    ]
    start_s = time.process_time()
    transfers, _ = _watched(SonarConfig(), pings)
    cpu_s = time.process_time() - start_s
    _, notices = _watched(SonarConfig(transfer=store.law, db_per_count=store.db_per_count), pings)
    interval = weigh_pings(pings).db_interval
    return JudgedLaw(
        scene,
        seed,
        looks,
        store,
        transfers[0],
        transfers[-1],
        interval,
        tuple(notice.code for notice in notices),
        cpu_s,
    )


def _watched(sonar: SonarConfig, pings: Sequence[Ping]) -> tuple[list[Transfer], list[Notice]]:
    watch = LawWatch(sonar)
    verdicts = [verdict for ping in pings if (verdict := watch.add(ping)) is not None]
    last = watch.finish()
    verdicts += [] if last is None else [last]
    return [v.transfer for v in verdicts if v.transfer is not None], [notice for v in verdicts for notice in v.notices]


def judged_missions(task: tuple[str, int, int]) -> list[JudgedLaw]:
    """Judge all recorders over one floor: scene, seed, looks."""
    scene, seed, looks = task
    intensity = floor_intensity(scene, seed, looks)
    return [judge_law(scene, seed, looks, store, intensity.copy()) for store in STORES]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench law`."""
    parser.add_argument(
        "--seeds", type=count, default=4, help=f"floors of each scene, from seed {FIRST_SEED} (default 4)"
    )
    parser.add_argument(
        "--scene",
        action="append",
        choices=named_scenes(),
        help=f"named scene, repeatable (default {', '.join(FLOORS)})",
    )
    parser.add_argument("--workers", type=count, default=2, help="processes (default 2)")
    parser.add_argument("--markdown", action="store_true", help="print tables in Markdown")
    parser.add_argument(
        "--log", type=Path, action="append", metavar="LOG", help="recorded log to judge instead, repeatable"
    )


def run(arguments: argparse.Namespace) -> int:
    """Simulate and judge, or read logs; returns the exit code. Raises BadInputError for a log that cannot be read."""
    if arguments.log is not None:
        for path in arguments.log:
            _print_log(path)
        return 0
    scenes = arguments.scene or list(FLOORS)
    tasks = [(scene, FIRST_SEED + k, looks) for k, scene, looks in product(range(arguments.seeds), scenes, LOOKS)]
    missions: list[JudgedLaw] = []
    for done, some in enumerate(run_tasks(judged_missions, tasks, Farm(arguments.workers)), 1):
        missions += some
        print(f"\r{done} of {len(tasks)} floors", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    print_tables(missions, markdown if arguments.markdown else columns)
    return 0


def print_tables(
    missions: Sequence[JudgedLaw], laid_out: Callable[[Sequence[str], Sequence[Sequence[str]]], str]
) -> None:
    """Print the tables of judged missions. laid_out: writes one table."""
    header = (
        "",
        "missions",
        "law right",
        "at once",
        "wrong doubts",
        "dB/count within 15 %",
        "off by, 5 % to 95 %",
        "worst",
        "interval holds",
    )
    groups: list[tuple[str, Callable[[JudgedLaw], str]]] = [
        ("all", lambda m: "all"),
        ("law", lambda m: m.store.name),
        ("looks", lambda m: f"{m.looks} looks"),
        ("format", lambda m: f"{m.store.bits} bits, {'clipping' if m.store.clips else 'not clipping'}"),
        ("floor", lambda m: m.scene),
    ]
    rows = []
    for _, key in groups:
        for name in dict.fromkeys(key(mission) for mission in missions):
            rows.append(_row(name, [mission for mission in missions if key(mission) == name]))
    print(laid_out(header, rows))
    cpu_ms = [1e3 * mission.cpu_s for mission in missions]
    print(
        f"\nprocessor time of the decision per mission: median {np.median(cpu_ms):.0f} ms, 95 % "
        f"{np.quantile(cpu_ms, 0.95):.0f} ms"
    )


def _row(name: str, missions: Sequence[JudgedLaw]) -> tuple[str, ...]:
    right = sum(m.ended.kind == m.store.law for m in missions)
    at_once = sum(m.decided.kind == m.store.law for m in missions)
    doubted = sum(bool(m.doubts) for m in missions)
    errors = decibel_errors(missions)
    if len(errors):
        low, high = np.quantile(errors, (0.05, 0.95))
        within = f"{np.mean(np.abs(errors) <= WITHIN):.1%}"
        spread, worst = f"{low:+.0%} to {high:+.0%}", f"{errors[np.abs(errors).argmax()]:+.0%}"
        holds = f"{interval_coverage(missions):.1%}"
    else:
        within = spread = worst = holds = "-"
    n = len(missions)
    return name, str(n), f"{right / n:.1%}", f"{at_once / n:.1%}", str(doubted), within, spread, worst, holds


def decibel_errors(missions: Sequence[JudgedLaw]) -> NDArray[np.float64]:
    """Compute the relative error of decibels per count at the end of missions whose logarithm was recognised."""
    known = [(m.ended.db_per_count, m.store.db_per_count) for m in missions if m.ended.kind == "log"]
    return np.array([found / true - 1.0 for found, true in known if true is not None])


def interval_coverage(missions: Sequence[JudgedLaw]) -> float:
    """Compute the share of missions with a logarithm whose interval of decibels per count holds the true ones."""
    logs = [(m.db_interval, m.store.db_per_count) for m in missions if m.store.db_per_count is not None]
    return float(np.mean([low <= true <= high for (low, high), true in logs]))


def _print_log(path: Path) -> None:
    pings = list(_pings_of(path))
    transfers, notices = _watched(SonarConfig(), pings)
    print(f"{path}: {len(pings)} pings")
    for notice in notices:
        print(f"  {notice.code}{' at ' + notice.place if notice.place else ''}: {notice.text}")
    laws: tuple[Law, ...] = ("amplitude", "intensity", "log")
    for law in laws:
        db_per_count = transfers[-1].db_per_count if law == "log" == transfers[-1].kind else None
        doubts = _watched(SonarConfig(transfer=law, db_per_count=db_per_count), pings)[1]
        print(f"  configured as '{law}': {', '.join(notice.code for notice in doubts) or 'no doubt'}")


def _pings_of(path: Path) -> Iterator[Ping]:
    return (event for event in open_mission([path], Config()).events() if isinstance(event, Ping))
