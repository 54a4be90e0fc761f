"""Compute what is stored: the answers to short missions, what scenarios expect, and every `--help`.

A mission's answer has each contact (id, place, p_mine, class) and some totals, so that a difference can be put in
words, and a digest of every file that the chain writes, so that none is missed. Digests depend on the C kernels and on
the platform that `platform` names; across platforms contacts and classes are the same and places agree to
`PLACE_TOLERANCE_M`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import platform as host
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, TypeAlias

import cv2
import msgspec
import numpy as np
import scipy
from msgspec.structs import replace

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.clearance.clearance_map import ClearanceMap
from auv_mcm.clearance.detection_performance import configured_performance
from auv_mcm.cli import _parser
from auv_mcm.errors import BadInputError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import CoveragePatch, Notice, PipelineEvent
from auv_mcm.settings.config import Config
from auv_mcm.shell.mission_totals import clearance_notices, contact_totals, notice_lists, search_totals
from auv_mcm.shell.results import plan_waypoints, write_clearance
from auv_mcm.shell.tally import Tally
from sim_replay.commands.bench import BENCHES, opened
from sim_replay.hil.scenario import read_scenario, shipped
from sim_replay.logs.recorded import open_mission
from sim_replay.missions import config_for
from sim_replay.scoring import score_files
from sim_replay.simulate import simulate
from sim_replay.simulator.scene import Lawnmower, Scene
from sim_replay.simulator.scene_file import named_scenes, read_scene
from tests.contradictions import all_contradictions
from tests.make.results import write_results

Answer: TypeAlias = dict[str, Any]

STORED: Final = Path(__file__).parent / "stored"
LINES: Final = Path(__file__).resolve().parents[3] / "shared" / "data" / "sidescan"
"""Recorded lines; what they hold is not stored here, only the chain's answer."""

LEG_M: Final = 30.0  # with two legs there are tiles of both sides and second views; all in a minute of a core (chosen)
N_LEGS: Final = 2
PLACE_DIGITS: Final = 8  # of a degree: 1 mm
P_DIGITS: Final = 4  # of p_mine: a hundredth of what counts as a change


def scene_names() -> tuple[str, ...]:
    """Name the scenes that ship."""
    return named_scenes()


def line_names() -> tuple[str, ...]:
    """Name the recorded lines that an answer is stored of."""
    return tuple(sorted(path.stem.removeprefix("line-") for path in STORED.glob("line-*.json")))


def shortened(scene: Scene) -> Scene:
    """Cut a scene to short legs, with as many scattered objects per metre of leg as before."""
    plan = scene.track.plan
    assert isinstance(plan, Lawnmower), "a plan of another kind is shortened otherwise"
    n_legs = min(N_LEGS, plan.n_legs)
    share = n_legs * LEG_M / (plan.n_legs * plan.leg_m)
    return replace(
        scene,
        track=replace(scene.track, plan=replace(plan, n_legs=n_legs, leg_m=LEG_M)),
        scatter=tuple(replace(each, count=max(1, round(each.count * share))) for each in scene.scatter),
        objects=tuple(
            each
            for each in scene.objects
            if each.leg is not None and each.leg < n_legs and each.along_m is not None and each.along_m < LEG_M
        ),
    )


def scene_answer(name: str) -> Answer:
    """Fly a short mission of a named scene and return the chain's answer to it."""
    scene = shortened(read_scene(name))
    with tempfile.TemporaryDirectory() as folder:
        simulated = simulate(scene, Path(folder))
        answer = chain_answer(simulated.log, config_for(scene), Path(folder))
        found = score_files([Path(folder) / "contacts.geojson", simulated.truth], threshold=MINE_LIKE_P).at_threshold.pd
        return {
            "platform": platform(),
            "log": _digest(simulated.log.read_bytes()),
            **answer,
            "totals": {**answer["totals"], "targets_seen": found.of, "targets_found": found.count},
        }


def line_answer(path: Path) -> Answer:
    """Return the chain's answer to a recorded line, or the error that says why there is none."""
    with tempfile.TemporaryDirectory() as folder:
        start = {"platform": platform(), "log": _digest(path.read_bytes())}
        try:
            return {**start, **chain_answer(path, Config(), Path(folder))}
        except BadInputError as error:
            return {**start, "error": str(error).replace(str(path), path.name)}


def chain_answer(log: Path, config: Config, folder: Path) -> Answer:
    """Run the chain over a log; the files that it writes are left in `folder`, which is there."""
    mission = open_mission([log], config)
    pipeline, tally = Pipeline(config), Tally()
    searched = ClearanceMap(configured_performance(config))
    coverage: list[CoveragePatch] = []
    notices: list[Notice] = []

    def gather(events: list[PipelineEvent]) -> None:
        for event in events:
            if isinstance(event, CoveragePatch):
                coverage.append(event)
                searched.add(event)
            elif isinstance(event, Notice):
                notices.append(event)

    for event in mission.events():
        tally.add(event)
        gather(list(pipeline.feed(event)))
    gather(list(pipeline.finish()))
    contacts = sorted(pipeline.contacts, key=lambda contact: contact.id)
    counters = mission.counters() + pipeline.counters
    waypoints = plan_waypoints(contacts, tally, config, counters)
    write_results(folder, contacts, coverage, waypoints, config.mission)
    clearance = searched.snapshot()
    write_clearance(folder, clearance, b"")
    gather(list(clearance_notices(clearance)))
    totals = {**tally.totals(), **contact_totals(contacts, coverage), **search_totals(clearance, contacts)}
    said = all_contradictions(folder / "contacts.geojson")
    return {
        **({"contradictions": said} if said else {}),
        "contacts": _contacts(json.loads((folder / "contacts.geojson").read_bytes())),
        "totals": {**_numbers(totals), "waypoints": len(waypoints)},
        "notices": _notices(notice_lists(notices)),
        "counters": dict(sorted(counters.items())),
        "digests": {path.name: _digest(path.read_bytes()) for path in sorted(folder.iterdir()) if _is_result(path)},
    }


def help_answer() -> Answer:
    """List the words of every `--help`.

    The words alone: how argparse lays them out depends on the terminal's width and differs between Python 3.11 and
    3.14.
    """
    return dict(_help("auv-mcm", _parser())) | {
        f"auv-mcm bench {name}": _words(_bench_parser(module)) for name, (module, _) in BENCHES.items()
    }


def scenario_answer() -> Answer:
    """List what every HIL scenario that ships expects, in the order of its verdict."""
    expected = {
        name: [
            {"test": expectation.test, "expected": msgspec.to_builtins(expectation.expected)}
            for expectation in read_scenario(name).scenario.expectations
        ]
        for name in shipped()
    }
    stored: Answer = json.loads(json.dumps(expected))  # as it is read back: lists for tuples
    return stored


def platform() -> str:
    """Name what decides the last bits of an answer beside our own code."""
    extensions = np.show_config(mode="dicts")["SIMD Extensions"]
    simd = "+".join([*extensions["baseline"], *extensions.get("found", ())])
    return f"{host.machine()} {simd}, numpy {np.__version__}, opencv {cv2.__version__}, scipy {scipy.__version__}"


def read_stored(name: str) -> Answer | None:
    """Read a stored answer; None if there is none of that name."""
    path = STORED / f"{name}.json"
    answer: Answer | None = json.loads(path.read_text("utf-8")) if path.exists() else None
    return answer


def store(name: str, answer: Answer) -> None:
    """Store an answer, a contact or a count to a line, so that a diff can be read."""
    (STORED / f"{name}.json").write_text(_pretty(answer) + "\n", "utf-8")


def _pretty(value: Any, depth: int = 0) -> str:
    """Write JSON whose innermost objects and lists, and whatever is short, take one line."""
    flat = json.dumps(value, ensure_ascii=False)
    is_flat = not isinstance(value, dict | list) or (depth > 0 and len(flat) <= 110)
    if is_flat or not value:
        return flat
    indent = "  " * (depth + 1)
    items = (
        [f"{json.dumps(key)}: {_pretty(inner, depth + 1)}" for key, inner in value.items()]
        if isinstance(value, dict)
        else [_pretty(inner, depth + 1) for inner in value]
    )
    first, last = "{}" if isinstance(value, dict) else "[]"
    return first + "\n" + ",\n".join(indent + item for item in items) + "\n" + "  " * depth + last


def _contacts(collection: Answer) -> list[Answer]:
    return [
        {
            "id": each["properties"]["id"],
            "place": None if each["geometry"] is None else [round(x, PLACE_DIGITS) for x in _place(each)],
            "p_mine": round(each["properties"]["p_mine"], P_DIGITS),
            "class": each["properties"]["class"],
        }
        for each in collection["features"]
    ]


def _place(feature: Answer) -> list[float]:
    place: list[float] = feature["geometry"]["coordinates"][:2]
    return place


def _numbers(totals: Answer) -> Answer:
    flat = {
        **{key: value for key, value in totals.items() if not isinstance(value, dict)},
        **{
            f"{key}.{inner}": value for key, values in totals.items() if isinstance(values, dict)
            for inner, value in values.items()
        },
    }  # fmt: skip
    return {
        key: round(value, 6) if isinstance(value, float) else value
        for key, value in sorted(flat.items())
        if isinstance(value, int | float)
    }


def _notices(lists: dict[str, list[dict[str, str]]]) -> list[str]:
    return sorted(f"{each['code']}: {each['text']}" for notices in lists.values() for each in notices)


def _is_result(path: Path) -> bool:
    return path.name.startswith(("contacts.", "coverage.", "waypoints.", "clearance."))


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def _bench_parser(module: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser()
    opened(module, parser)
    return parser


def _help(name: str, parser: argparse.ArgumentParser) -> Iterator[tuple[str, Answer]]:
    yield name, _words(parser)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner, subparser in action.choices.items():
                yield from _help(f"{name} {inner}", subparser)


def _words(parser: argparse.ArgumentParser) -> Answer:
    described = {
        **({"about": _one_line(parser.description)} if parser.description else {}),
        **({"after": _one_line(parser.epilog)} if parser.epilog else {}),
    }
    return described | {
        "arguments": {
            _signature(action): _one_line(action.help)
            for action in parser._actions
            if action.help != argparse.SUPPRESS and not isinstance(action, argparse._HelpAction)
        }
    }


def _signature(action: argparse.Action) -> str:
    """Write an argument's names and values as in a usage line, and that it is required."""
    metavar = action.metavar or (action.dest.upper() if action.option_strings else action.dest)
    values = "" if action.nargs == 0 else " ".join(metavar) if isinstance(metavar, tuple) else metavar
    if action.choices is not None and not isinstance(action, argparse._SubParsersAction):
        values += " of " + ",".join(map(str, action.choices))
    many = "" if action.nargs in (None, 0) else f" ({action.nargs})"
    required = " required" if action.required and action.option_strings else ""
    return f"{', '.join(action.option_strings)} {values}{many}{required}".strip()


def _one_line(text: str | None) -> str:
    return " ".join((text or "").split())
