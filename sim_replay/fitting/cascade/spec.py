"""Read the YAML file of a training set, and derive its missions.

Simulated missions fly through scenes as they are, but with many more targets and rocks, an exact navigation, and silent
turns, so that what lies where in the picture is known to a pixel. Missions with recorded sea floor come from `auv-mcm
augment`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Annotated, Final, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from auv_mcm.errors import UsageError
from auv_mcm.settings.config import Config, SonarConfig
from auv_mcm.settings.strict_yaml import explain_validation_error, load_mapping, read_text
from sim_replay.fitting.cascade.tiles import Split
from sim_replay.missions import FIRST_SEED, config_for
from sim_replay.simulator import scene as limits
from sim_replay.simulator.objects import BY_WIDTH, USUAL
from sim_replay.simulator.plan import swath_m
from sim_replay.simulator.scene import EXACT, TARGET_KINDS, Scatter, Scene, SeabedType, SizeRange, Sonar, TargetKind
from sim_replay.simulator.scene_file import check_scene, read_scene

_STREAM: Final = 0x53504543  # keeps these random numbers apart from others of the same seed
_EDGE: Final = 0.95  # of the swath: targets are put no farther out
_DEFAULT: Final = resources.files("sim_replay.fitting.cascade") / "default.yaml"

USUAL_SONAR: Final = SonarConfig()
"""That recorded augmented logs, where nothing else is configured."""

_Factor = Annotated[float, Meta(ge=0.1, le=10.0)]


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pass


class SeedRange(_Section, frozen=True, kw_only=True):
    """Name `count` seeds from `first` on; each makes one mission of every scene."""

    first: Annotated[int, Meta(ge=0, le=2**31)]
    count: Annotated[int, Meta(ge=1, le=10_000)]

    @property
    def seeds(self) -> range:
        """Return the seeds."""
        return range(self.first, self.first + self.count)


class Seeds(_Section, frozen=True, kw_only=True):
    """Choose the missions to train on, to stop the training, and to judge it."""

    train: SeedRange
    validate: SeedRange | None = None
    test: SeedRange | None = None


class Kind(_Section, frozen=True, kw_only=True):
    """Set how many of the targets are of a kind, in proportion to the other shares, and how large they are.

    What is left out is the scene's.
    """

    share: Annotated[float, Meta(gt=0.0, le=1000.0)] = 1.0
    length_m: SizeRange | None = None
    width_m: SizeRange | None = None
    height_m: SizeRange | None = None
    burial_m: SizeRange | None = None


class Targets(_Section, frozen=True, kw_only=True):
    """Describe the targets the targets of each mission, apart_m from each other at least.

    Echo strengths and ranges are those that the scene gives a kind.
    """

    per_mission: Annotated[int, Meta(ge=1, le=2000)] = 80
    apart_m: Annotated[float, Meta(ge=2.0, le=100.0)] = 6.0
    kinds: Annotated[dict[TargetKind, Kind], Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: {kind: Kind() for kind in ("cylinder", "sphere", "truncated_cone", "wedge", "box")}
    )


class Rocks(_Section, frozen=True, kw_only=True):
    """Scatter rocks of about a mine's size, besides the stones that the sea floor itself has.

    Sizes left out are the scene's.
    """

    per_mission: Annotated[int, Meta(ge=0, le=2000)] = 80
    length_m: SizeRange | None = None
    height_m: SizeRange | None = None


class SonarVariant(_Section, frozen=True, kw_only=True):
    """Describe a sonar and the grid of the picture.

    What is left out is the scene's, and the default configuration's for the grid.
    """

    frequency_khz: limits.Frequency | None = None
    range_m: limits.MaxRange | None = None
    n_samples: limits.Samples | None = None
    ping_rate_hz: limits.PingRate | None = None
    beam_width_deg: limits.BeamWidth | None = None
    range_resolution_m: limits.RangeResolution | None = None
    row_spacing_m: Annotated[float, Meta(ge=0.01, le=2.0)] | None = None
    column_spacing_m: Annotated[float, Meta(ge=0.005, le=2.0)] | None = None


class AugmentedLog(_Section, frozen=True, kw_only=True):
    """Name a folder that `auv-mcm augment` wrote, and which split its sea floor belongs to.

    The path begins at the spec's own folder. Its picture has the grid of the first sonar.
    """

    folder: str
    split: Split


class Spec(_Section, frozen=True, kw_only=True):
    """Describe a training set.

    scenes: named ones, or files from the spec's own folder on. sonars: missions of a scene take them in turn.
    altitude_factor: a mission's altitude is the scene's times a number drawn evenly from here. seabed_factors: how much
    more or less of a type of sea floor there is than in the scenes, as in the area that a vehicle is meant for; 0
    leaves it out, 1 for types left out.
    """

    scenes: tuple[str, ...] = ()
    seeds: Seeds | None = None
    targets: Targets = msgspec.field(default_factory=Targets)
    rocks: Rocks = Rocks()
    sonars: Annotated[tuple[SonarVariant, ...], Meta(min_length=1)] = (SonarVariant(),)
    altitude_factor: tuple[_Factor, _Factor] = (1.0, 1.0)
    seabed_factors: dict[SeabedType, Annotated[float, Meta(ge=0.0, le=1000.0)]] = {}
    augmented: tuple[AugmentedLog, ...] = ()


class SimulatedLine(NamedTuple):
    """Name a mission to fly: a complete scene, and the configuration that makes its picture."""

    scene: Scene
    config: Config
    split: Split
    background: str


class AugmentedLine(NamedTuple):
    """Name a recorded line with targets put into it, to be replayed."""

    folder: Path
    config: Config
    split: Split


def read_training_spec(path: Path | None = None) -> tuple[Spec, Path]:
    """Read a spec from a file, the one that ships if None, and the folder that its paths start from.

    Raises UsageError if it cannot be read, or as parse_spec does.
    """
    if path is None:
        return parse_training_spec(_DEFAULT.read_text("utf-8"), "the default spec"), Path()
    return parse_training_spec(read_text(path, "training set"), str(path)), path.parent


def parse_training_spec(text: str, place: str) -> Spec:
    """Parse a spec from YAML text; `place` names it in messages.

    Raises UsageError with the key's path for unknown and repeated keys, wrong types, values out of range, and
    contradictions.
    """
    data = load_mapping(text, place, "expected keys such as 'scenes:'")
    try:
        spec = msgspec.convert(data, Spec)
    except msgspec.ValidationError as error:
        raise UsageError(
            f"{place}: {explain_validation_error(error, Spec)}. See sim_replay/fitting/cascade/default.yaml for an "
            "example"
        ) from error
    for reason in _contradictions(spec):
        raise UsageError(f"{place}: {reason}")
    return spec


def lines_of(spec: Spec, folder: Path, sonar: SonarConfig = USUAL_SONAR) -> tuple[SimulatedLine | AugmentedLine, ...]:
    """List all missions of a spec, ready to be rendered.

    Simulated ones split by split and seed by seed, then augmented ones.

    Parameters
    ----------
    folder
        That paths start from.
    sonar
        That recorded the augmented ones.

    Raises UsageError for scenes that are not there or cannot be, and two of one name.
    """
    scenes = {}
    for name in spec.scenes:
        beside = folder / name
        scene = read_scene(str(beside) if beside.is_file() else name)
        label = scene.name or Path(name).stem
        if label in scenes:
            raise UsageError(f"`scenes`: two are named '{label}', but sea floors are identified by it. Rename one")
        scenes[label] = scene
    simulated = [
        _simulated(spec, label, scene, seed, number, split)
        for split, seeds in _seeds_by_split(spec)
        for number, seed in enumerate(seeds.seeds)
        for label, scene in scenes.items()
    ]
    own = on_grid(Config(sonar=sonar), spec.sonars[0])
    return (*simulated, *(AugmentedLine(folder / log.folder, own, log.split) for log in spec.augmented))


def carrying(scene: Scene, sonar: SonarVariant) -> Scene:
    """Let the scene's vehicle carry a sonar; what that leaves out is the scene's."""
    given = {name: value for name in Sonar.__struct_fields__ if (value := getattr(sonar, name, None)) is not None}
    return msgspec.structs.replace(scene, sonar=msgspec.structs.replace(scene.sonar, **given))


def on_grid(config: Config, sonar: SonarVariant) -> Config:
    """Configure the grid of a sonar's picture."""
    names = ("row_spacing_m", "column_spacing_m")
    grid = {name: value for name in names if (value := getattr(sonar, name)) is not None}
    return msgspec.structs.replace(config, waterfall=msgspec.structs.replace(config.waterfall, **grid))


def training_scene(spec: Spec, scene: Scene, seed: int, sonar: SonarVariant) -> Scene:
    """Change the scene to how it is flown for training."""
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, _STREAM])))
    factor = float(random.uniform(*spec.altitude_factor))
    seabeds = tuple(
        msgspec.structs.replace(seabed, share=share)
        for seabed in scene.world.seabeds
        if (share := seabed.share * spec.seabed_factors.get(seabed.type, 1.0)) > 0.0
    )
    if not seabeds:
        raise UsageError(
            f"`seabed_factors` leave nothing of the sea floor of scene '{scene.name}'. Take the scene out of `scenes`"
        )
    flown = msgspec.structs.replace(
        carrying(scene, sonar),
        seed=seed,
        world=msgspec.structs.replace(scene.world, seabeds=seabeds),
        track=msgspec.structs.replace(scene.track, altitude_m=scene.track.altitude_m * factor, pings_in_turns=False),
        navigation_error=EXACT,
        faults=(),
    )
    return within_swath(msgspec.structs.replace(flown, scatter=_scatter(spec, scene)))


def _simulated(spec: Spec, label: str, scene: Scene, seed: int, number: int, split: Split) -> SimulatedLine:
    sonar = spec.sonars[number % len(spec.sonars)]
    flown = training_scene(spec, scene, seed, sonar)
    check_scene(flown, f"scene {label} as the spec changes it")
    return SimulatedLine(flown, on_grid(config_for(flown), sonar), split, f"{label}/{seed}")


def _scatter(spec: Spec, scene: Scene) -> tuple[Scatter, ...]:
    """Return the scene's other objects, some of them large, then targets, then rocks."""
    own = {group.kind: group for group in scene.scatter}
    some_target = next((group for group in scene.scatter if group.kind in TARGET_KINDS), None)
    groups = [group for group in scene.scatter if group.kind != "rock" and group.kind not in TARGET_KINDS]
    counts = _shared_out(spec.targets.per_mission, [kind.share for kind in spec.targets.kinds.values()])
    for (kind, wanted), count in zip(spec.targets.kinds.items(), counts, strict=True):
        if count == 0:
            continue
        like = Scatter(kind=kind, count=1)
        if some_target is not None:
            like = msgspec.structs.replace(
                like, ground_range_m=some_target.ground_range_m, strength_db=some_target.strength_db
            )
        sizes = {
            name: value
            for name in ("length_m", "width_m", "height_m", "burial_m")
            if (value := getattr(wanted, name)) is not None
        }
        groups.append(msgspec.structs.replace(own.get(kind, like), count=count, apart_m=spec.targets.apart_m, **sizes))
    if spec.rocks.per_mission:
        usual = USUAL["rock"].strength_db
        rocks = own.get(
            "rock", Scatter(kind="rock", count=1, strength_db=(usual - 6.0, usual + 6.0), natural_sizes=True)
        )
        sizes = {name: value for name in ("length_m", "height_m") if (value := getattr(spec.rocks, name)) is not None}
        groups.append(msgspec.structs.replace(rocks, count=spec.rocks.per_mission, **sizes))
    return tuple(groups)


def within_swath(scene: Scene) -> Scene:
    """Scatter nothing beyond what the scene's sonar reaches."""
    farthest_m = _EDGE * swath_m(scene)
    within = []
    for group in scene.scatter:
        if group.ground_range_m is not None:
            nearest, far = group.ground_range_m
            group = msgspec.structs.replace(group, ground_range_m=(min(nearest, farthest_m), min(far, farthest_m)))
        within.append(group)
    return msgspec.structs.replace(scene, scatter=tuple(within))


def _shared_out(total: int, shares: list[float]) -> list[int]:
    """Share out whole numbers with a sum of total in proportion to shares, by largest remainders."""
    exact = [total * share / math.fsum(shares) for share in shares]
    counts = [math.floor(value) for value in exact]
    for index in sorted(range(len(exact)), key=lambda k: counts[k] - exact[k])[: total - sum(counts)]:
        counts[index] += 1
    return counts


def _seeds_by_split(spec: Spec) -> Iterator[tuple[Split, SeedRange]]:
    if spec.seeds is None:
        return
    yield "train", spec.seeds.train
    if spec.seeds.validate is not None:
        yield "validate", spec.seeds.validate
    if spec.seeds.test is not None:
        yield "test", spec.seeds.test


def _contradictions(spec: Spec) -> Iterator[str]:
    if not spec.scenes and not spec.augmented:
        yield "nothing to render: give `scenes` and `seeds`, or `augmented`"
    if spec.scenes and spec.seeds is None:
        yield (
            "`scenes` are given without `seeds`. Give at least "
            "seeds: {train: {first: 600, count: 1}, validate: {first: 700, count: 1}}"
        )
    if spec.seeds is not None and not spec.scenes:
        yield "`seeds` are given without `scenes`"
    ranges = list(_seeds_by_split(spec))
    for split, seeds in ranges:
        if seeds.seeds.stop > FIRST_SEED:
            yield (
                f"`seeds.{split}` ends at {seeds.seeds.stop - 1}: rates are reported for seeds from {FIRST_SEED} on. "
                "Use smaller seeds for training"
            )
        for other, others in ranges:
            if other > split and max(seeds.first, others.first) < min(seeds.seeds.stop, others.seeds.stop):
                yield (
                    f"`seeds.{split}` and `seeds.{other}` share seeds: the same sea floor would be trained on and "
                    "judged by"
                )
    for kind, wanted in spec.targets.kinds.items():
        for name in BY_WIDTH.get(kind, ()):
            if getattr(wanted, name) is not None:
                yield f"`targets.kinds.{kind}.{name}` changes nothing: it goes by the diameter. Give that as `width_m`"
    low, high = spec.altitude_factor
    if low > high:
        yield f"`altitude_factor` is [{low:g}, {high:g}]; the lowest comes first"
    for index, log in enumerate(spec.augmented):
        if any(other.folder == log.folder for other in spec.augmented[:index]):
            yield f"`augmented[{index}].folder`: {log.folder} is given twice"
