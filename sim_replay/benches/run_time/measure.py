"""Measure operating points on missions: each in a process of its own, all in turn, so that a busy computer slows all of
them alike."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import cv2
import msgspec
import numpy as np

from auv_mcm import __version__, kernels
from auv_mcm.errors import BadInputError
from auv_mcm.settings.config import config_yaml
from sim_replay.benches.run_time import one_run
from sim_replay.benches.run_time.lines import BenchMission
from sim_replay.benches.run_time.points import ChainSetting
from sim_replay.scoring.inputs import ReportedContact, ScoredMission, parse_contacts
from sim_replay.scoring.intervals import Density, Proportion, density
from sim_replay.scoring.score import score_missions
from sim_replay.scoring.thresholds import pd_at

LIMITS_PER_KM2: Final = (10.0, 100.0, 300.0)  # false alarms per km² at which Pd is printed
CALLED_P: Final = 0.2
"""p_mine from which on contacts are called mine-like."""
_PLACE_DIGITS: Final = 7  # of degrees: a centimetre
_ONE_THREAD: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "OPENCV_FOR_THREADS_NUM": "1"}
_PLAIN_SCRIPT: Final = (
    "import runpy, sys; sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')\n"
    "for line in open('/proc/self/status'):\n"
    "    if line.startswith('VmHWM'): print('{\"peak_memory_mb\": %f}' % (int(line.split()[1]) / 1024))"
)
"""Run the plain script as a program, then read its peak memory."""


class MissionCost(msgspec.Struct, frozen=True, kw_only=True):
    """Hold what one operating point cost on one mission.

    process_s: user and system time of the whole process, one per repeat; elapsed_s: by the clock; chain_s: processor
    time of the chain alone, from file to contacts. stages_s: medians of that per stage. counters: of work and of what
    was left out. called: places of contacts with p_mine of CALLED_P or more, latitude and longitude to a centimetre.
    covered_km2, chain_s, stages_s and counters are of the chain, empty for the plain script.
    """

    process_s: tuple[float, ...]
    elapsed_s: tuple[float, ...]
    chain_s: tuple[float, ...]
    stages_s: dict[str, float]
    peak_memory_mb: float
    sonar_s: float
    pings: int
    samples: int
    contacts: int
    covered_km2: float
    counters: dict[str, int]
    called: tuple[tuple[float, float], ...]
    contacts_sha256: str


class SettingResult(msgspec.Struct, frozen=True, kw_only=True):
    """Hold the result of one operating point over all missions.

    pd: at LIMITS_PER_KM2 of false alarms. contacts: per km² of swept area.
    """

    name: str
    knob: str
    value: str
    runs: dict[str, MissionCost]
    pd: tuple[Proportion, ...]
    contacts: Density

    def process_s(self, names: Sequence[str] | None = None) -> list[float]:
        """Sum the processor time of whole processes over missions, s, one per repeat."""
        some = list(self.runs.values()) if names is None else [self.runs[name] for name in names]
        return [sum(each) for each in zip(*(run.process_s for run in some), strict=True)]

    def stages_s(self) -> dict[str, float]:
        """Sum the processor time per stage over missions, s."""
        total: dict[str, float] = defaultdict(float)
        for run in self.runs.values():
            for stage, cost_s in run.stages_s.items():
                total[stage] += cost_s
        return dict(total)


class BenchMachine(msgspec.Struct, frozen=True, kw_only=True):
    """Hold what was measured on, and when.

    load: of the last minute before and after, in processes that wanted to run.
    """

    processor: str
    cores: int
    kernels: str
    versions: dict[str, str]
    date: str
    load: tuple[float, float]


def this_machine(load_before: float) -> BenchMachine:
    """Describe this computer and what runs on it."""
    return BenchMachine(
        processor=_processor(),
        cores=os.cpu_count() or 1,
        kernels=kernels.backend(),
        versions={
            "auv_mcm": __version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "opencv": cv2.__version__,
        },
        date=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        load=(load_before, os.getloadavg()[0]),
    )


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def measure_settings(
    points: Sequence[ChainSetting],
    lines: Sequence[BenchMission],
    repeat: int,
    folder: Path,
    progress: Callable[[str], None] = lambda words: None,
    environment: Mapping[str, str] = MappingProxyType({}),
) -> list[SettingResult]:
    """Run every point on every mission `repeat` times, all points in turn on each mission.

    environment: added to that of the runs.

    Raises BadInputError where a run fails, or where two runs of one point give different contacts.
    """
    raw: dict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)
    for number in range(repeat):
        for line in lines:
            for point in points:
                progress(f"run {number + 1} of {repeat}: {line.name}, {point.name}")
                raw[point.name, line.name].append(run_once(point, line, folder, environment))
    return [_result(point, lines, raw, folder) for point in points]


def run_once(
    point: ChainSetting, line: BenchMission, folder: Path, environment: Mapping[str, str] = MappingProxyType({})
) -> dict[str, Any]:
    """Run one point on one mission in a process of its own.

    Its costs and counts, and process_s, its user and system time.
    """
    contacts = contacts_path(point, line, folder)
    if point.is_plain_script:
        script = Path(__file__).with_name("plain_script.py")
        command = [sys.executable, "-c", _PLAIN_SCRIPT, str(script), str(line.log), str(contacts)]
    else:
        config = contacts.with_suffix(".yaml")
        config.write_text(config_yaml(point.configure(line.config)), "utf-8")
        command = [sys.executable, "-m", one_run.MODULE, str(line.log), "--config", str(config)]
        command += ["--contacts", str(contacts)]
    started_s = time.monotonic()
    output, process_s = timed(command, f"{point.name} on {line.name}", contacts.with_suffix(".err"), environment)
    elapsed_s = time.monotonic() - started_s
    done: dict[str, Any] = json.loads(output)
    data = contacts.read_bytes()
    return {
        "sonar_s": 0.0,
        **done,
        "process_s": process_s,
        "elapsed_s": elapsed_s,
        "contacts_sha256": hashlib.sha256(data).hexdigest(),
    }


def contacts_path(point: ChainSetting, line: BenchMission, folder: Path) -> Path:
    """Name the file of a point's contacts on a mission."""
    words = f"{point.name}-{line.name}"
    return folder / ("".join(letter if letter.isalnum() else "-" for letter in words) + ".geojson")


def timed(command: Sequence[str], what: str, errors: Path, environment: Mapping[str, str]) -> tuple[str, float]:
    """Run a program for its output, and its user and system time, s. Raises BadInputError if it fails.

    As of an installed program, its bytecode is kept: beside `errors`, from the first run on.
    """
    kept = {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(errors.parent / "bytecode")}
    env = {**os.environ, **kept, **_ONE_THREAD, **environment}
    with errors.open("wb+") as err, subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=err) as process:
        assert process.stdout is not None
        output = process.stdout.read().decode()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        said = errors.read_text("utf-8", "replace").strip().splitlines()
        raise BadInputError(f"{what} failed: {said[-1] if said else 'no message'}")
    return output, usage.ru_utime + usage.ru_stime


def _result(
    point: ChainSetting, lines: Sequence[BenchMission], raw: dict[tuple[str, str], list[dict[str, Any]]], folder: Path
) -> SettingResult:
    runs, missions, n_contacts = {}, [], 0
    for line in lines:
        each = raw[point.name, line.name]
        if len({one["contacts_sha256"] for one in each}) > 1:
            raise BadInputError(
                f"{point.name} on {line.name}: two runs gave different contacts, though nothing had changed"
            )
        found = parse_contacts(json.loads(contacts_path(point, line, folder).read_bytes()), line.name)
        runs[line.name] = _run(each, found)
        if line.kind in ("scene", "recorded"):
            missions.append(ScoredMission(found, line.truth, line.name))
            n_contacts += len(found)
    pd: tuple[Proportion, ...] = ()
    area_km2 = sum(mission.truth.area_km2 for mission in missions)
    if any(mission.truth.objects for mission in missions):
        score = score_missions(missions)
        pd = tuple(pd_at(score, limit) for limit in LIMITS_PER_KM2)
    return SettingResult(
        name=point.name,
        knob=point.knob,
        value=point.value,
        runs=runs,
        pd=pd,
        contacts=density(n_contacts, area_km2 or None),
    )


def _run(each: Sequence[dict[str, Any]], found: Sequence[ReportedContact]) -> MissionCost:
    first = each[0]
    stages = {name: statistics.median(one["stages_s"][name] for one in each) for name in first.get("stages_s", {})}
    return MissionCost(
        process_s=tuple(one["process_s"] for one in each),
        elapsed_s=tuple(one["elapsed_s"] for one in each),
        chain_s=tuple(one["chain_s"] for one in each if "chain_s" in one),
        stages_s=stages,
        peak_memory_mb=max(one["peak_memory_mb"] for one in each),
        sonar_s=first["sonar_s"],
        pings=first.get("pings", 0),
        samples=first.get("samples", 0),
        contacts=len(found),
        covered_km2=first.get("covered_km2", 0.0),
        counters=first.get("counters", {}),
        called=tuple(
            sorted(
                (round(one.latitude_deg, _PLACE_DIGITS), round(one.longitude_deg, _PLACE_DIGITS))
                for one in found
                if one.p_mine >= CALLED_P
            )
        ),
        contacts_sha256=first["contacts_sha256"],
    )


def median_ratio(result: SettingResult, other: SettingResult) -> tuple[float, float, float]:
    """Divide the processor time of one point by that of another, repeat by repeat: median, lowest, highest."""
    ratios = [a / b for a, b in zip(result.process_s(), other.process_s(), strict=True)]
    return statistics.median(ratios), min(ratios), max(ratios)


def times_real_time(run: MissionCost) -> float:
    """Divide the duration of the sonar's recording by the processor time of the chain alone."""
    return run.sonar_s / statistics.median(run.chain_s)
