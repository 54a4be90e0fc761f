"""Fly over Manta-like cones in a complex scene, as in the source paper's figure 13, and count what the chain calls.

auv-mcm bench figure13                    many seeds, and prints
auv-mcm bench figure13 --picture FILE     draws the first one's waterfall with true places and calls, too (.jpg, .webp)

Sand, ripples, boulders and seagrass lie in patches; rocks, debris and tyres lie on them. The scene is none of the named
ones. Calls are at the operating point that ships.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np

from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Tile
from sim_replay.arguments import count, new_file
from sim_replay.fitting.cascade.farm import Farm, run_tasks
from sim_replay.missions import config_for
from sim_replay.report.cards import place_m
from sim_replay.report.pictures import PictureCollector
from sim_replay.scoring.called import last_state
from sim_replay.scoring.inputs import ReportedContact, ScoredMission, Truth, parse_contacts, parse_truth
from sim_replay.scoring.intervals import density, proportion
from sim_replay.scoring.layout import Outcome, lay_out
from sim_replay.scoring.matching import UNMATCHED
from sim_replay.scoring.score import GATE_M
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, ObjectKind, Ripples, Scene, Seabed
from sim_replay.simulator.scene_file import read_scene
from sim_replay.studies.marked_waterfall import Mark, save_waterfall
from sim_replay.studies.paper_mines import MINES
from sim_replay.text_tables import columns, density_cell, markdown, share_cell

FIRST_SEED: Final = 94_201  # on seeds from here on nothing was fitted or tried before this study
KIND: Final = "truncated_cone"
_LEG_M: Final = 140.0  # m: one waterfall as long as it is wide
_N_CONES: Final = 8  # of a picture
_OTHERS: Final[dict[ObjectKind, int]] = {"rock": 8, "debris": 1, "tyre": 1}  # of a picture, chosen
_ALL: Final = "all"
_HEADER: Final = (
    *("sea floor", "km²", "cones", "reported", "called", "of these as truncated cone"),
    *("false alarms", "of them on objects", "per km²"),
)


class Cone(NamedTuple):
    """Hold a cone that the pass saw. found: whether a contact of any p_mine is on it; classification of the called."""

    seabed: str
    found: bool
    called: bool
    classification: str


class Alarm(NamedTuple):
    """Hold a call on no cone: the sea floor there, and the kind of object it lies on, "" for none."""

    contact: ReportedContact
    seabed: str
    on: str


class ComplexImage(NamedTuple):
    """Hold what the chain makes of one picture, and the area of each kind of sea floor in it."""

    cones: tuple[Cone, ...]
    alarms: tuple[Alarm, ...]
    area_km2: dict[str, float]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `auv-mcm bench figure13`."""
    parser.add_argument("--images", type=count, default=24, help="pictures, a seed each (default 24)")
    parser.add_argument(
        "--first-seed", type=count, default=FIRST_SEED, help=f"seed of the first (default {FIRST_SEED})"
    )
    parser.add_argument("--workers", type=count, default=2, help="missions flown at once (default 2)")
    parser.add_argument("--markdown", action="store_true", help="print tables in Markdown")
    parser.add_argument(
        "--picture", type=new_file, metavar="FILE", help="draw the first seed's waterfall (.jpg, .webp, .png)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Fly, judge and print; return the exit code. Raises UsageError for a picture that cannot be written."""
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.images)

    def progress(done: int) -> None:
        print(f"\r{done} of {len(seeds)} pictures", end="\n" if done == len(seeds) else "", file=sys.stderr, flush=True)

    print(report(list(run_tasks(fly, seeds, Farm(arguments.workers), progress)), in_markdown=arguments.markdown))
    if arguments.picture is not None:
        draw(arguments.first_seed, arguments.picture)
    return 0


def complex_scene(seed: int) -> Scene:
    """Build one leg over four kinds of sea floor, with the sonar and the strengths of echoes of the scene `mixed`."""
    scene = read_scene("mixed")
    ripples = Ripples(wavelength_m=0.9, height_m=0.11, direction_deg=100.0, defects=0.5)  # those of `mixed`
    world = msgspec.structs.replace(
        scene.world,
        patch_m=25.0,
        seabeds=(
            Seabed(type="sand", share=0.3),
            Seabed(type="rippled_sand", share=0.25, ripples=ripples),
            Seabed(type="boulder_field", share=0.2),
            Seabed(type="seagrass", share=0.25),
        ),
    )
    groups = {group.kind: group for group in scene.scatter}
    sizes = {name: (size_m, size_m) for name, size_m in MINES[KIND].sizes_m.items()}
    scatter = (
        msgspec.structs.replace(groups[KIND], count=_N_CONES, **sizes),
        *(msgspec.structs.replace(groups[kind], count=n) for kind, n in _OTHERS.items()),
    )
    plan = Lawnmower(heading_deg=75.0, n_legs=1, leg_m=_LEG_M)
    return msgspec.structs.replace(
        scene,
        name="complex",
        seed=seed,
        world=world,
        scatter=scatter,
        track=msgspec.structs.replace(scene.track, plan=plan, pings_in_turns=False),
    )


def fly(seed: int) -> ComplexImage:
    """Fly over the scene of a seed and judge the contacts."""
    gc.collect()  # a mission refers to itself: the sea floor of the one before would stay for long
    mission, pipeline, _ = _flown(seed)
    return judge(_reported(pipeline), parse_truth(mission.truth(), "complex"))


def judge(contacts: Sequence[ReportedContact], truth: Truth) -> ComplexImage:
    """Match all contacts with the truth, and then the called ones alone."""
    every = lay_out(ScoredMission(tuple(contacts), truth), GATE_M)
    own = lay_out(ScoredMission(tuple(one for one in contacts if one.called), truth), GATE_M)
    found, called = last_state(every), last_state(own)
    holder = {index: contact for contact, index in enumerate(called.matched.tolist()) if index != UNMATCHED}
    cones = [
        Cone(
            seabed=own.object_seabed[index],
            found=bool((found.matched == index).any()),
            called=index in holder,
            classification=own.contacts[holder[index]].classification if index in holder else "",
        )
        for index, is_cone in enumerate((own.is_target & own.is_seen).tolist())
        if is_cone
    ]
    alarms = []
    for contact, outcome in enumerate(called.outcome.tolist()):
        if outcome in (Outcome.ON_CLUTTER, Outcome.ELSEWHERE):
            away = {
                float(distance): own.objects[index].kind
                for index, distance in enumerate((own.offset_m[contact] ** 2).sum(axis=1).tolist())
                if own.near[contact, index]
            }
            on = away[min(away)] if outcome == Outcome.ON_CLUTTER else ""
            alarms.append(Alarm(own.contacts[contact], own.contact_seabed[contact], on))
    return ComplexImage(tuple(cones), tuple(alarms), own.seabed_area_km2)


def report(images: Sequence[ComplexImage], *, in_markdown: bool = False) -> str:
    """Lay out every kind of sea floor and all together, what false alarms lie on, and the classes of called cones."""
    seabeds = [*dict.fromkeys(seabed for image in images for seabed in image.area_km2), _ALL]
    on = Counter(alarm.on or f"{alarm.seabed}, on no object" for image in images for alarm in image.alarms)
    classes = Counter(cone.classification for image in images for cone in image.cones if cone.called)
    table = markdown if in_markdown else columns
    parts = [
        table(_HEADER, [_row(seabed, images) for seabed in seabeds]),
        table(("false alarms on", "n"), [[words, str(n)] for words, n in on.most_common()]),
        table(("class of called cones", "n"), [[words, str(n)] for words, n in classes.most_common()]),
    ]
    return "\n\n".join(parts)


def _row(seabed: str, images: Sequence[ComplexImage]) -> list[str]:
    cones = [one for image in images for one in image.cones if seabed in (one.seabed, _ALL)]
    alarms = [one for image in images for one in image.alarms if seabed in (one.seabed, _ALL)]
    area_km2 = sum(km2 for image in images for name, km2 in image.area_km2.items() if seabed in (name, _ALL))
    n_called = sum(one.called for one in cones)
    return [
        seabed,
        f"{area_km2:.3f}",
        str(len(cones)),
        share_cell(proportion(sum(one.found for one in cones), len(cones))),
        share_cell(proportion(n_called, len(cones))),
        share_cell(proportion(sum(one.classification == KIND for one in cones), n_called)),
        str(len(alarms)),
        str(sum(bool(one.on) for one in alarms)),
        density_cell(density(len(alarms), area_km2)),
    ]


def draw(seed: int, path: Path) -> None:
    """Draw one waterfall with the true places of cones and all calls."""
    save_waterfall(*marked(seed), path)


def marked(seed: int) -> tuple[PictureCollector, list[Mark]]:
    """Fly over the scene of a seed; return its waterfall, and marks of all cones seen and all false alarms."""
    mission, pipeline, pictures = _flown(seed)
    facts = mission.truth()
    reported = _reported(pipeline)
    image = judge(reported, parse_truth(facts, "complex"))
    moments, along_m = pictures.times()[::-1]
    marks = []
    seen = [one for one in facts["objects"] if one["is_target"] and one["looks"]]
    for cone, fact in zip(image.cones, seen, strict=True):
        look = fact["looks"][0]
        across_m = look["ground_range_m"] * (1.0 if look["side"] == "starboard" else -1.0)
        moment = datetime.fromisoformat(look["time"]).timestamp()
        style = "called" if cone.called else "reported but not called" if cone.found else "not reported"
        marks.append(Mark(float(np.interp(moment, moments, along_m)), across_m, f"cone, {style}"))
    contact_of = dict(zip(reported, pipeline.contacts, strict=True))
    for alarm in image.alarms:
        marks.append(Mark(*place_m(contact_of[alarm.contact].views[0]), "false alarm"))
    return pictures, marks


def _flown(seed: int) -> tuple[Mission, Pipeline, PictureCollector]:
    scene = complex_scene(seed)
    mission, pipeline, pictures = Mission(scene), Pipeline(config_for(scene)), PictureCollector()
    for event in mission.events():
        _collect(pipeline.feed(event), pictures)
    _collect(pipeline.finish(), pictures)
    return mission, pipeline, pictures


def _collect(events: Iterable[object], pictures: PictureCollector) -> None:
    for event in events:
        if isinstance(event, Tile):
            pictures.add_tile(event)


def _reported(pipeline: Pipeline) -> tuple[ReportedContact, ...]:
    return parse_contacts(json.loads(contacts_geojson(pipeline.contacts)), "complex")
