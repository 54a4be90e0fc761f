"""Compare the mines left that the payload reports, by its own map of the sea floor, with the truth of named scenes.

auv-mcm bench clearance                           flies, judges and prints
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np

from auv_mcm.clearance.clearance_map import Clearance, ClearanceMap
from auv_mcm.clearance.detection_performance import configured_performance
from auv_mcm.clearance.residual import remaining_about, remaining_mines
from auv_mcm.contacts.contact import is_mine_like
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Contact, CoveragePatch
from sim_replay.benches.experiment import Cell, Column, Experiment, Task, mission_source, number
from sim_replay.fitting.detection_performance.looks import GATE_M
from sim_replay.flights import fly_through
from sim_replay.missions import SCENES
from sim_replay.scoring.inputs import parse_truth
from sim_replay.scoring.matching import gates_m
from sim_replay.simulator.scene import TARGET_KINDS, Scene

CHAIN: Final = "as shipped"


class JudgedClearance(msgspec.Struct, frozen=True, kw_only=True):
    """Hold one judged mission.

    n_targets: seen on legs; n_found: near a contact called mine-like. by_tables: sum of p_detected where they lie.

    expected: mines left, by the mission's own evidence.
    """

    n_targets: int
    n_found: int
    by_tables: float
    expected: float

    @property
    def n_left(self) -> int:
        """Count the targets that were not found."""
        return self.n_targets - self.n_found

    @property
    def is_inside(self) -> bool:
        """Check whether the 95 % interval holds the mines left."""
        remaining = remaining_about(self.expected)
        return remaining.low <= self.n_left <= remaining.high


def fly(task: Task) -> dict[str, JudgedClearance]:
    """Fly one mission with the whole chain, with its mines or without."""
    change = without_mines if task.options["without_mines"] else lambda scene: scene
    with mission_source(task, change) as source:
        searched = ClearanceMap(configured_performance(source.config))
        pipeline = Pipeline(source.config)
        fly_through(
            source.events, {CHAIN: pipeline}, lambda one: searched.add(one) if isinstance(one, CoveragePatch) else None
        )
        truth = parse_truth(source.truth(), task.scene)
    clearance = searched.snapshot()
    assert clearance is not None  # a named scene is seen
    targets = [(one.latitude_deg, one.longitude_deg) for one in truth.objects if one.is_target and one.looks]
    return {CHAIN: judge_mission(clearance, pipeline.contacts, targets)}


def without_mines(scene: Scene) -> Scene:
    """Take the mines out of a scene."""
    return msgspec.structs.replace(
        scene, scatter=tuple(some for some in scene.scatter if some.kind not in TARGET_KINDS)
    )


def judge_mission(
    clearance: Clearance, contacts: Sequence[Contact], targets_deg: Sequence[tuple[float, float]]
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
        n_targets=len(at_m),
        n_found=int(np.count_nonzero((distance_m <= gates_m(GATE_M, sigma_m)).any(axis=1))),
        by_tables=float(p_detected[north[inside], east[inside]].sum()),
        expected=remaining_mines(
            [contact.p_mine for contact in contacts],
            [is_mine_like(contact) for contact in contacts],
            p_detected[clearance.seen],
        ).expected,
    )


def _add_without_mines(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--without-mines", action="store_true", help="take the mines out of the scenes")


def _inside(missions: Sequence[JudgedClearance]) -> Cell:
    return Cell(f"{sum(one.is_inside for one in missions)} of {len(missions)}")


EXPERIMENT: Final = Experiment(
    name="clearance",
    scenes=SCENES,
    first_seed=91001,  # of missions that nothing was fitted on
    n_seeds=2,
    variant_title="estimate",
    variants=(CHAIN,),
    fly=fly,
    columns=(
        Column("targets", lambda missions: number(sum(one.n_targets for one in missions))),
        Column("found", lambda missions: number(sum(one.n_found for one in missions))),
        Column("by the tables", lambda missions: number(sum(one.by_tables for one in missions), 1)),
        Column("left", lambda missions: number(sum(one.n_left for one in missions))),
        Column("expected", lambda missions: number(sum(one.expected for one in missions), 1)),
        Column("in the interval", _inside),
    ),
    add_options=_add_without_mines,
    own_options=("without_mines",),
)
