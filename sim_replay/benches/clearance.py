"""Compare the mines left that the payload reports, by its own map of the sea floor, with the truth of named scenes.

auv-mcm bench clearance                           flies, judges and prints
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.clearance.clearance_map import Clearance, ClearanceMap
from auv_mcm.clearance.detection_performance import shipped_performance
from auv_mcm.clearance.residual import DOUBTFUL_SHARE, remaining_about, without_contact
from auv_mcm.contacts.contact import is_mine_like
from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, CoveragePatch
from auv_mcm.shell.whole_files import write_file
from sim_replay.benches.mission_options import add_scene_options, chosen_scenes, chosen_seeds
from sim_replay.benches.progress import counted
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.fitting.detection_performance.looks import GATE_M
from sim_replay.missions import config_for
from sim_replay.scoring.matching import gates_m
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import TARGET_KINDS
from sim_replay.simulator.scene_file import read_scene
from sim_replay.text_tables import columns, markdown

FIRST_SEED: Final = 91001  # of missions that nothing was fitted on
_HEADER = (
    "scene",
    "missions",
    "targets",
    "found",
    "by the tables",
    "left",
    "expected",
    "in the interval",
    "expected, scene left out",
    "in it",
)


class ClearanceTask(msgspec.Struct, frozen=True, kw_only=True):
    """Name a mission over a named scene, with its mines or without."""

    scene: str
    seed: int
    with_targets: bool


class JudgedClearance(msgspec.Struct, frozen=True, kw_only=True):
    """Hold one judged mission.

    n_targets: seen on legs; n_found: near a contact called mine-like. by_tables: sum of p_detected where they lie.

    p_doubtful: sum of p_mine over contacts not called. p_detected: mean over what was searched.
    """

    scene: str
    n_targets: int
    n_found: int
    by_tables: float
    p_doubtful: float
    p_detected: float

    @property
    def n_left(self) -> int:
        """Count the targets that were not found."""
        return self.n_targets - self.n_found

    def expected(self, share: float = DOUBTFUL_SHARE) -> float:
        """Compute the mines left, with a share of the doubtful sum."""
        return share * self.p_doubtful + without_contact(self.p_detected)

    def is_inside(self, share: float = DOUBTFUL_SHARE) -> bool:
        """Check whether the 95 % interval holds the mines left."""
        remaining = remaining_about(self.expected(share))
        return remaining.low <= self.n_left <= remaining.high


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench clearance`."""
    add_scene_options(parser, FIRST_SEED)
    parser.add_argument("--without-mines", action="store_true", help="take the mines out of the scenes")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write what was judged to FILE")


def run(arguments: argparse.Namespace) -> int:
    """Fly, judge and print; returns the exit code.

    Raises UsageError for unknown scenes and a file that cannot be written.
    """
    names = chosen_scenes(arguments.scenes)
    seeds = chosen_seeds(arguments)
    tasks = [
        ClearanceTask(scene=name, seed=seed, with_targets=not arguments.without_mines)
        for name in names
        for seed in seeds
    ]
    missions = list(run_tasks(judged, tasks, Farm(arguments.workers), counted(len(tasks))))
    print(f"{len(missions)} missions, seeds {seeds[0]} to {seeds[-1]} of each scene\n")
    print(report(missions, arguments.markdown))
    if arguments.json is not None:
        try:
            write_file(arguments.json, msgspec.json.format(msgspec.json.encode(missions)))
        except OSError as error:
            raise UsageError(f"--json {arguments.json} cannot be written: {error.strerror}") from error
    return 0


def judged(task: ClearanceTask) -> JudgedClearance:
    """Fly one mission with the whole chain."""
    scene = msgspec.structs.replace(read_scene(task.scene), seed=task.seed)
    if not task.with_targets:
        scene = msgspec.structs.replace(
            scene, scatter=tuple(some for some in scene.scatter if some.kind not in TARGET_KINDS)
        )
    mission = Mission(scene)
    pipeline = Pipeline(config_for(scene))
    searched = ClearanceMap(shipped_performance())
    for event in mission.events():
        for result in pipeline.feed(event):
            if isinstance(result, CoveragePatch):
                searched.add(result)
    for result in pipeline.finish():
        if isinstance(result, CoveragePatch):
            searched.add(result)
    clearance = searched.snapshot()
    assert clearance is not None  # a named scene is seen
    targets = [item for item in mission.truth()["objects"] if item["is_target"] and item["looks"]]
    return judge_mission(
        task.scene, clearance, pipeline.contacts, [(target["lat"], target["lon"]) for target in targets]
    )


def judge_mission(
    scene: str, clearance: Clearance, contacts: Sequence[Contact], targets_deg: Sequence[tuple[float, float]]
) -> JudgedClearance:
    """Compare a search with where targets really lie, latitude and longitude in degrees."""
    frame = LocalFrame(latitude_deg=clearance.origin_latitude_deg, longitude_deg=clearance.origin_longitude_deg)
    at_m = np.array([frame.to_enu(*place, 0.0)[:2] for place in targets_deg]).reshape(-1, 2)
    called = [contact for contact in contacts if is_mine_like(contact)]
    place_m = np.array([frame.to_enu(c.latitude_deg, c.longitude_deg, 0.0)[:2] for c in called]).reshape(-1, 2)
    sigma_m = np.sqrt([max(float(np.linalg.eigvalsh(c.covariance_m2)[-1]), 0.0) for c in called])
    distance_m = np.hypot(*(at_m[:, np.newaxis] - place_m).transpose(2, 0, 1))
    index = np.floor(at_m / clearance.cell_m).astype(np.int64)
    east, north = index[:, 0] - clearance.first_east, index[:, 1] - clearance.first_north
    n_north, n_east = clearance.looks.shape
    inside = (east >= 0) & (east < n_east) & (north >= 0) & (north < n_north)
    p_detected = clearance.p_detected
    return JudgedClearance(
        scene=scene,
        n_targets=len(at_m),
        n_found=int(np.count_nonzero((distance_m <= gates_m(GATE_M, sigma_m)).any(axis=1))),
        by_tables=float(p_detected[north[inside], east[inside]].sum()),
        p_doubtful=float(sum(contact.p_mine for contact in contacts if contact.p_mine < MINE_LIKE_P)),
        p_detected=float(p_detected[clearance.seen].mean()),
    )


def fitted_share(missions: Sequence[JudgedClearance]) -> float:
    """Fit the share of the doubtful sum that makes the mines expected as many as those left."""
    doubtful = sum(mission.p_doubtful for mission in missions)
    left = sum(mission.n_left - without_contact(mission.p_detected) for mission in missions)
    return max(left / doubtful, 0.0) if doubtful > 0.0 else 0.0


def report(missions: Sequence[JudgedClearance], in_markdown: bool = False) -> str:
    """Lay out missions by scene and all together.

    The share that the scene's estimates use is fitted on the other scenes alone.
    """
    names = list(dict.fromkeys(mission.scene for mission in missions))
    shares = {
        name: fitted_share([mission for mission in missions if mission.scene != name] or missions) for name in names
    }
    rows = []
    for name in (*names, "all"):
        some = [mission for mission in missions if name in (mission.scene, "all")]
        counts = [len(some), sum(m.n_targets for m in some), sum(m.n_found for m in some)]
        inside, inside_left_out = (sum(m.is_inside() for m in some), sum(m.is_inside(shares[m.scene]) for m in some))
        rows.append(
            [
                name,
                *map(str, counts),
                f"{sum(m.by_tables for m in some):.1f}",
                str(sum(m.n_left for m in some)),
                f"{sum(m.expected() for m in some):.1f}",
                f"{inside} of {len(some)}",
                f"{sum(m.expected(shares[m.scene]) for m in some):.1f}",
                f"{inside_left_out} of {len(some)}",
            ]
        )
    laid_out = markdown if in_markdown else columns
    low, high = min(shares.values()), max(shares.values())
    return laid_out(_HEADER, rows) + (
        f"\n\nof the sum of p_mine over contacts not called {fitted_share(missions):.3f} were mines left, {low:.3f} to "
        f"{high:.3f} with a "
        f"scene left out; {DOUBTFUL_SHARE:g} is what the payload takes"
    )
