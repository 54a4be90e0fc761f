"""Simulate a mission."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from auv_mcm.commands import Commands, Progress, add_json_option, answer, command, whole
from auv_mcm.errors import UsageError


def add(commands: Commands) -> None:
    """Add `auv-mcm simulate` to the command line."""
    parser = command(
        commands,
        "simulate",
        "fly a simulated mission and write its log and the truth",
        "Writes mission.xtf, for 'auv-mcm replay', and truth.json, for 'auv-mcm score'. SCENE is a YAML file or the "
        "name of a\n"
        "scene that ships with the package (--list). The same scene and seed give the same bytes.",
        [
            "auv-mcm simulate --list",
            "auv-mcm simulate ripple --out sim",
            "auv-mcm simulate my-scene.yaml --out sim --seed 7",
        ],
    )
    parser.add_argument(
        "scene", metavar="SCENE", nargs="?", help="YAML file, or name of a scene that ships with the package"
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="directory for the results, made if it is not there")
    parser.add_argument(
        "--seed",
        metavar="N",
        type=whole(0, 2**32 - 1),
        help="seed to use instead of the scene's own: other speckle, other drawn objects",
    )
    parser.add_argument(
        "--threads",
        metavar="N",
        type=whole(1, 64),
        default=1,
        help="threads that share the work; the bytes are the same (default 1)",
    )
    parser.add_argument("--list", action="store_true", help="list the scenes that ship with the package")
    add_json_option(parser)
    parser.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from msgspec.structs import replace

    from sim_replay.simulator.scene_file import named_scenes, read_scene

    if arguments.list:
        answer({"scenes": named_scenes()}, named_scenes(), as_json=arguments.json)
        return 0
    if arguments.scene is None or arguments.out is None:
        raise UsageError("a SCENE and --out DIR are needed; 'auv-mcm simulate --help' explains")

    from sim_replay.simulate import simulate  # needs the bench extra, which a list does not

    scene = read_scene(arguments.scene)
    if arguments.seed is not None:
        scene = replace(scene, seed=arguments.seed)
    start_s = time.perf_counter()
    with Progress("simulate") as progress:
        done = simulate(scene, arguments.out, threads=arguments.threads, progress=progress.show)
    speed = done.duration_s / (time.perf_counter() - start_s)
    words = [
        f"{done.n_pings} pings in {done.duration_s:.0f} s, {speed:.0f} times real time; {done.area_km2:g} km² swept",
        f"{done.n_objects} objects, {done.n_targets} of them targets",
        f"log: {done.log}",
        f"truth: {done.truth}",
    ]
    answer(done._asdict(), words, as_json=arguments.json)
    return 0
