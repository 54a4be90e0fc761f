"""Measure what the simulator costs, and the error of its shadows at that cost.

auv-mcm bench simulate   CPU time of one core, medians of interleaved repetitions

The rendering figures are 1000 pings of 1000 samples over 50 m by 50 m of rippled sand with relief, one side, in blocks
of 64, as many rows as a mission makes at a time. Source paper: 7 s for 1000 by 1000 on a Core 2 Duo. The mission is
flown in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.records import Ping
from auv_mcm.solids.shapes import Box, Cylinder, Shape, Sphere, TruncatedCone, Wedge, view_shape
from sim_replay.arguments import count, duration_min
from sim_replay.simulator import backend, rays, scene
from sim_replay.simulator.backscatter import TABLE_SIZE
from sim_replay.simulator.bodies import pack
from sim_replay.simulator.echo import beam_table, bin_ranges_m, floor_tables, recorder_gain
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.objects import PlacedObject, bodies_of, place_objects
from sim_replay.simulator.recording import complete, record
from sim_replay.simulator.render import Lines, Rendered, render_numpy, render_pings
from sim_replay.simulator.scene import Lawnmower, ObjectKind, Scene, SceneObject, Seabed, Sonar, Track
from sim_replay.simulator.speckle import row_keys, speckle_rows, speckle_rows_numpy
from sim_replay.simulator.vehicle import SonarPose
from sim_replay.simulator.world import NODES, Patches, SimulatedFloor

_SOURCE_PAPER_S: Final = 7.0  # s for one image of 1000 x 1000 samples (source paper)
_SWATH_M: Final = 50.0  # m of range, and of track
_ALTITUDE_M: Final = 6.0  # m above the sea floor
_N_PINGS: Final = 1000  # as in the source paper
_N_SAMPLES: Final = 1000  # as in the source paper
_BLOCK: Final = 64  # pings rendered at once
_NOISE: Final = 1e-3  # intensity added, so that logarithms are finite
_CELLS_M: Final = (0.1, 0.05, 0.025)  # m: grids whose errors are compared

Speckle: TypeAlias = Callable[[NDArray[np.float64], NDArray[np.uint64]], NDArray[np.float32]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench simulate`."""
    parser.add_argument("--repeat", type=count, default=15, help="repetitions of each step (default 15)")
    parser.add_argument(
        "--minutes", type=duration_min, default=30.0, help="length of the mission that is streamed (default 30)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure and print; returns the exit code."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    print(
        f"CPU time of one core, C library: {backend.simulator_library().reason}, median of {arguments.repeat} "
        "interleaved repetitions\n"
    )
    _print_rendering(arguments.repeat)
    _print_accuracy(arguments.repeat)
    _print_mission(arguments.minutes)
    return 0


# --- cost ---


class RayTask(NamedTuple):
    """Hold all rays of one pass along the square, in blocks of pings, and what the renderer needs with them."""

    scene: Scene
    patches: Patches
    tables: NDArray[np.float32]
    beam: NDArray[np.float32]
    blocks: tuple[Lines, ...]
    n_nodes: int


def _scene(cell_m: float, beam_lines: int) -> Scene:
    return Scene(
        world=scene.World(seabeds=(Seabed(type="rippled_sand"),), cell_m=cell_m),
        sonar=Sonar(range_m=_SWATH_M, n_samples=_N_SAMPLES, beam_lines=beam_lines, range_resolution_m=0.0),
        track=Track(plan=Lawnmower(n_legs=1, leg_m=_SWATH_M), altitude_m=_ALTITUDE_M),
    )


def _task(what: Scene, world: SimulatedFloor) -> RayTask:
    """Place pings to starboard every 5 cm along the western side of the square."""
    depth_m = what.world.depth_m - _ALTITUDE_M
    norths = np.arange(_N_PINGS) * (_SWATH_M / _N_PINGS)
    poses = [
        SonarPose(0.0, 0.0, float(north), depth_m, 0.0, 0.0, 0.0, 0.0, what.track.speed_mps, 0) for north in norths
    ]
    fan = rays.fan(poses, np.zeros(_N_PINGS), what.sonar, what.world.depth_m, what.world.cell_m)
    starboard = fan.ping % 2 == 1
    fan = fan._replace(**{name: values[starboard] for name, values in fan._asdict().items() if name != "n_nodes"})
    fan = fan._replace(ping=fan.ping // 2)
    patches = world.patches(*rays.crossed(fan, what.world.cell_m))
    lines = rays.lines(fan, what.world.cell_m)
    blocks = []
    for first in range(0, _N_PINGS, _BLOCK):
        own = (lines.ping >= first) & (lines.ping < first + _BLOCK)
        part = Lines(**{name: values[own] for name, values in lines._asdict().items()})
        blocks.append(part._replace(ping=part.ping - first))
    beam = beam_table(what.sonar.vertical_beam_width_deg)
    return RayTask(what, patches, floor_tables(what, world.covers), beam, tuple(blocks), fan.n_nodes)


def _render_all(task: RayTask, work: Callable[..., Rendered], speckle: Speckle | None) -> None:
    """Render the energy of all pings; with speckle, recorded samples as well."""
    sonar = task.scene.sonar
    bin_m = sonar.range_m / sonar.n_samples
    r = bin_ranges_m(sonar)
    level, recorder = 1e3 * r**-3.0, complete(sonar.recorder)
    gain = recorder_gain(r, sonar, 100.0, 0.5 * sonar.range_m)
    nothing = pack([])
    for index, lines in enumerate(task.blocks):
        n_pings = min(_BLOCK, _N_PINGS - index * _BLOCK)
        energy = work(
            lines,
            task.patches,
            nothing,
            task.tables,
            task.beam,
            cell_m=task.scene.world.cell_m,
            n_nodes=task.n_nodes,
            n_pings=n_pings,
            n_bins=sonar.n_samples,
            bin_m=bin_m,
        ).energy
        if speckle is not None:
            intensity = energy * level
            intensity += _NOISE
            record(speckle(intensity, row_keys(1, [0], index * _BLOCK, n_pings)), gain, 6, recorder, bin_m)


def _medians_ms(steps: dict[str, Callable[[], None]], repeat: int) -> dict[str, float]:
    """Time each step once per round, ms, so that all meet the same state of the machine.

    One round before it counts, so that none meets another's memory in the cache.
    """
    times: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(repeat):
        for name, step in steps.items():
            step()
            start = time.process_time()
            step()
            times[name].append(1e3 * (time.process_time() - start))
    return {name: statistics.median(values) for name, values in times.items()}


def _print_rendering(repeat: int) -> None:
    what, wide = _scene(0.05, 1), _scene(0.05, 5)
    world = SimulatedFloor(what.world, what.seed)
    task, fan_task = _task(what, world), _task(wide, world)
    needed = task.patches.slots >= 0
    place = task.patches.first_patch_row, task.patches.first_patch_column

    def synthesise() -> None:
        SimulatedFloor(what.world, what.seed, max_patches=int(needed.sum())).patches(needed, *place)

    steps: dict[str, Callable[[], None]] = {
        "numpy: rays": lambda: _render_all(task, render_numpy, None),
        "numpy: rays, speckle, 16-bit recorder": lambda: _render_all(task, render_numpy, speckle_rows_numpy),
        "numpy: 5 rays per ping": lambda: _render_all(fan_task, render_numpy, None),
    }
    if backend.library() is not None:
        steps = {
            "C: rays": lambda: _render_all(task, render_pings, None),
            "C: rays, speckle, 16-bit recorder": lambda: _render_all(task, render_pings, speckle_rows),
            "C: 5 rays per ping": lambda: _render_all(fan_task, render_pings, None),
            **steps,
        }
    steps["sea floor from scratch"] = synthesise
    medians = _medians_ms(steps, repeat)
    print(f"{_N_PINGS} pings x {_N_SAMPLES} samples, cells of 5 cm{'ms':>16}{'source paper / this':>22}")
    for name, cost_ms in medians.items():
        print(f"  {name:<40}{cost_ms:>16.1f}{1e3 * _SOURCE_PAPER_S / cost_ms:>22.0f}")
    n_patches = int(needed.sum())
    per_patch_ms = medians["sea floor from scratch"] / n_patches
    side_m = (NODES - 1) * what.world.cell_m
    share = (_SWATH_M / side_m) ** 2 / n_patches
    print(
        f"  the sea floor is {n_patches} patches of {side_m:.1f} m, {per_patch_ms:.1f} ms each with its fields; "
        f"{share * medians['sea floor from scratch']:.0f} ms for 50 m x 50 m\n"
    )


# --- accuracy ---

_SOLIDS: Final[dict[ObjectKind, Callable[[PlacedObject], Shape]]] = {
    "sphere": lambda p: Sphere(radius_m=0.5 * p.width_m),
    "cylinder": lambda p: Cylinder(radius_m=0.5 * p.width_m, length_m=p.length_m, azimuth_rad=p.azimuth_rad),
    "truncated_cone": lambda p: TruncatedCone(
        base_radius_m=0.5 * p.width_m, top_radius_m=0.5 * p.top_m, height_m=p.height_m
    ),
    "wedge": lambda p: Wedge(length_m=p.length_m, width_m=p.width_m, height_m=p.height_m, azimuth_rad=p.azimuth_rad),
    "box": lambda p: Box(length_m=p.length_m, width_m=p.width_m, height_m=p.height_m, azimuth_rad=p.azimuth_rad),
}


def shadow_errors_m(cell_m: float) -> NDArray[np.float64]:
    """Measure how far beyond the closed form shadows of usual mine shapes end, m.

    At 10 to 30 m on a level floor, by rays through their middles.
    """
    shape = (1, NODES, NODES)
    size = 2 * math.ceil(45.0 / cell_m / (NODES - 1) + 1)
    level = Patches(
        np.zeros(shape, np.float32),
        np.ones(shape, np.float32),
        np.zeros(shape, np.uint8),
        np.zeros((size, size), np.int32),
        -(size // 2),
        -(size // 2),
    )
    one, n_nodes = np.ones(1), math.ceil(45.0 / cell_m)
    ray = Lines(0 * one, 0 * one, 0 * one, one, _ALTITUDE_M * one, one, one, 0 * one, one, np.zeros(1, np.int64))
    even = np.ones((2, TABLE_SIZE), dtype=np.float32)
    errors = []
    for kind, solid in _SOLIDS.items():
        for turn, ground_range_m in enumerate(np.linspace(10.0, 30.0, 41).tolist()):
            scene_object = SceneObject(kind=kind, east_m=ground_range_m, north_m=0.0, azimuth_deg=37.0 * turn % 360.0)
            (placed,) = place_objects(Scene(objects=(scene_object,), track=Track(plan=Lawnmower())))
            lit = render_pings(
                ray,
                level,
                pack(bodies_of(placed, lambda east_m, north_m: 0.0, 1)),
                even,
                even[0],
                cell_m=cell_m,
                n_nodes=n_nodes,
                n_pings=1,
                n_bins=1,
                bin_m=1e3,
                keep_nodes=True,
            ).lit
            assert lit is not None
            last = int(np.flatnonzero(lit[0] < 1.0)[-1])
            if last > 0:  # node 0 ends no facet; ramps may be lit down to the floor
                expected = view_shape(solid(placed), 0.0, ground_range_m, _ALTITUDE_M).shadow_end_m
                errors.append((last - float(lit[0, last])) * cell_m - float(expected))
    return np.array(errors)


def _print_accuracy(repeat: int) -> None:
    tasks = {}
    for cell_m in _CELLS_M:
        what = _scene(cell_m, 1)
        tasks[cell_m] = _task(what, SimulatedFloor(what.world, what.seed))
    medians = _medians_ms(
        {f"{cell_m}": partial(_render_all, task, render_pings, None) for cell_m, task in tasks.items()}, repeat
    )
    print(
        f"shadow ends against closed forms, {len(_SOLIDS)} shapes at 10 to 30 m, and {_N_PINGS} pings of "
        f"{_SWATH_M:.0f} m"
    )
    print(f"  {'cell':<16}{'rms error cm':>14}{'in cells':>10}{'worst cm':>10}{'ms':>10}")
    for cell_m in _CELLS_M:
        errors = shadow_errors_m(cell_m)
        rms = float(np.sqrt(np.mean(errors**2)))
        worst = float(np.abs(errors).max())
        cost_ms = medians[f"{cell_m}"]
        print(
            f"  {1e2 * cell_m:4.1f} "
            f"cm{'':<9}{1e2 * rms:>14.1f}{rms / cell_m:>10.2f}{1e2 * worst:>10.1f}{cost_ms:>10.1f}"
        )
    print()


# --- mission ---


def _print_mission(minutes: float) -> None:
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "sim_replay.benches.simulate", f"{minutes}"]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        last = result.stderr.strip().splitlines()[-1:] or ["no message"]
        raise BadInputError(f"the mission's process ended with {result.returncode}: {last[0]}")
    summary: dict[str, Any] = json.loads(result.stdout)
    print(
        f"mission of {summary['duration_s'] / 60.0:.0f} min, two sides of {summary['n_samples']} samples, "
        f"{summary['beam_lines']} rays per ping and side, sand: {summary['pings']} pings in {summary['cost_s']:.1f} s, "
        f"{summary['duration_s'] / summary['cost_s']:.0f} x real time, peak memory {summary['peak_memory_mb']:.0f} MB "
        f"({summary['memory_before_mb']:.0f} MB before it starts)"
    )


def _fly(minutes: float) -> dict[str, Any]:
    """Fly one mission in this process and discard its events as they come."""
    before_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    leg_m = 400.0
    plain = Scene(track=Track(plan=Lawnmower(leg_m=leg_m)))
    n_legs = math.ceil(minutes * 60.0 * plain.track.speed_mps / leg_m) + 1
    mission = Mission(replace(plain, track=replace(plain.track, plan=Lawnmower(n_legs=n_legs, leg_m=leg_m))))
    wanted = math.ceil(minutes * 60.0 * plain.sonar.ping_rate_hz)
    start = time.process_time()
    n_pings = sum(1 for _ in islice((event for event in mission.events() if isinstance(event, Ping)), wanted))
    return {
        "pings": n_pings,
        "duration_s": n_pings / plain.sonar.ping_rate_hz,
        "n_samples": plain.sonar.n_samples,
        "beam_lines": plain.sonar.beam_lines,
        "cost_s": time.process_time() - start,
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "memory_before_mb": before_mb,
    }


def _main(arguments: Sequence[str]) -> int:
    print(json.dumps(_fly(float(arguments[0]))))
    return 0


if __name__ == "__main__":
    raise SystemExit(_main(sys.argv[1:]))
