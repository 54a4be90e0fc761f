"""Fit the weights with which confirmation turns what it measures into the odds of a mine, for `auv-mcm calibrate odds`.

Simulated missions over the named scenes, with seeds that nothing is scored on, give detections whose truth is known.
Each detector has weights of its own, those of the trained cascade without the scenes that are held out from its
training. With --crowded the scenes are flown again, over other floors, with more mines and stones, since these are
hardest to separate; the usual scenes give the rarity of mines. With --drawn missions of the wide world join them. Every
step of the look is taken, whatever the odds. A target is the most mine-like detection within the
gate of one, per side and passage; further detections of it count for nothing, and all others are the clutter to
separate mines from.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import chain
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final, NamedTuple, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.details import detection_details
from auv_mcm.classify.features import Features, detector_features
from auv_mcm.classify.odds import MineOdds, Tree, Weights
from auv_mcm.confirmation import examine, region_of
from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Detection, Detector, LookStep, SourceEvent
from auv_mcm.settings.config import Config
from auv_mcm.shell.whole_files import make_directory, write_file
from sim_replay.fitting.cascade import trees
from sim_replay.fitting.wide_world import wide_scene
from sim_replay.missions import HELD_OUT, SCENES, config_for, reporting_everything, served_by
from sim_replay.scoring.calibration import calibration_error
from sim_replay.scoring.matching import gates_m
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.objects import place_objects
from sim_replay.simulator.scene import Scene, TargetKind
from sim_replay.simulator.scene_file import read_scene

Array = NDArray[np.float64]

FIRST_SEED: Final = 500  # rates are taken on seeds from 9100 on, and settings were tried on seeds below 500
CROWD: Final = 3
"""Times as many mines and rocks."""
_DRAWN_CROWD: Final = 2  # times as many in drawn missions: 67 looks at targets each instead of 36, in the same time
_CROWDING: Final = frozenset({*get_args(TargetKind), "rock"})
_CROWD_APART_M: Final = 9.0  # m between objects of crowded missions, minimum
CROWD_SEEDS: Final = 50  # after the first: other floors than those of the scenes as they are
DRAWN_SEEDS: Final = 10_000  # after the first: missions are known by their seeds in the report
_GATE_M: Final = 2.0  # m between detection and object, maximum, as in scoring
_CLEAR_M: Final = 3.0  # m around objects where a detection counts as neither
_PASSAGE_S: Final = 60.0  # s: detections of an object nearer in time are of one pass
_FAINT_P: Final = 0.03  # the detector's p_mine below which detections are thinned
_RIDGE: Final = 2.0  # of the logistic regression, per feature of unit variance
_DIGITS: Final = 5  # decimals in the file
_MAX_SHIFT: Final = 50.0  # nats
_SHARES: Final = (0.3, 0.5, 0.7, 0.9)  # of targets
_PARTS: Final = (0.25, 0.5, 1.0)  # of missions
N_TREES: Final[Mapping[LookStep, int]] = {"detector": 100, "contours": 500, "shape": 500}
"""Trees of each step for the cascade's detections; of the first, fewer, since it is asked of every detection."""
STEPS: Final[tuple[LookStep, ...]] = ("detector", "contours", "shape")
_NO_TREES: Final[Mapping[LookStep, int]] = dict.fromkeys(N_TREES, 0)


class Example(NamedTuple):
    """Hold a detection with the measurements of every step, and its label.

    details: what only trees weigh. weight: how many it stands for. seed: of its mission. usual: of one with as many
    objects as its scene has, so that it shows how rare mines are. on_object: on an object of the truth, target or not.
    """

    scene: str
    seed: int
    usual: bool
    is_target: bool
    weight: float
    detector: Features
    contours: Features
    shape: Features
    details: dict[LookStep, Features]
    on_object: bool = False


class StepTable(NamedTuple):
    """Hold what a step measured of n detections: values (n, k) by name, of which sums weigh the first n_summed."""

    names: tuple[str, ...]
    n_summed: int
    values: Array

    def without(self, names: Collection[str]) -> StepTable:
        """Leave columns out."""
        kept = [column for column, name in enumerate(self.names) if name not in names]
        n_summed = sum(column < self.n_summed for column in kept)
        return StepTable(tuple(self.names[column] for column in kept), n_summed, self.values[:, kept])


class LookTable(NamedTuple):
    """Hold examples as arrays, (n,) each, and a table per step; fields as in Example."""

    usual: NDArray[np.bool_]
    is_target: NDArray[np.bool_]
    on_object: NDArray[np.bool_]
    weight: Array
    steps: Mapping[LookStep, StepTable]

    def at(self, chosen: NDArray[np.bool_]) -> LookTable:
        """Take the chosen examples, (n,) bool."""
        steps = {step: table._replace(values=table.values[chosen]) for step, table in self.steps.items()}
        return LookTable(self.usual[chosen], self.is_target[chosen], self.on_object[chosen], self.weight[chosen], steps)


class Thinning(NamedTuple):
    """Set which faint detections are looked at.

    One in `kept`, which counts as many; all those on objects if these are spared.
    """

    kept: int
    spares_objects: bool


OF_SCENES: Final = Thinning(4, False)
"""As the weights that ship were fitted."""
OF_DRAWN: Final = Thinning(12, True)
"""Two detections in three are faint, and a look costs as much for each: so a third less time for as many targets."""


class _Label(NamedTuple):
    is_target: bool
    on_object: bool
    weight: float


def crowded(scene: Scene, times: int) -> Scene:
    """Crowd the scene with `times` as many mines and rocks.

    They lie far enough apart for none to count among another's neighbours; where there are more than usual they find
    their places after all else.
    """
    if times == 1:
        return scene
    others = [each for each in scene.scatter if each.kind not in _CROWDING]
    crowd = [
        msgspec.structs.replace(each, count=times * each.count, apart_m=max(each.apart_m, _CROWD_APART_M))
        for each in scene.scatter
        if each.kind in _CROWDING
    ]
    return msgspec.structs.replace(scene, scatter=(*others, *crowd))


def examples_of(name: str, seed: int, detector: Detector, crowd: int) -> list[Example]:
    """Collect all detections of one mission through a named scene by one of the detectors.

    With `crowd` times as many mines and rocks.
    """
    scene = crowded(msgspec.structs.replace(read_scene(name), seed=seed), crowd)
    mission = Mission(scene)
    config = served_by(detector, config_for(scene))
    return examples_along(name, seed, config, mission.events(), lambda: mission.truth()["objects"], usual=crowd == 1)


def drawn_scene(seed: int) -> Scene:
    """Draw a mission of the wide world, with twice as many mines and stones where there is room for them."""
    scene = wide_scene(seed)
    crowd = crowded(scene, _DRAWN_CROWD)
    try:
        place_objects(crowd)
    except UsageError:
        return scene
    return crowd


def examples_of_drawn(seed: int, detector: Detector) -> list[Example]:
    """Collect all detections of one mission of the wide world by one of the detectors."""
    scene = drawn_scene(seed)
    mission = Mission(scene)
    config = served_by(detector, config_for(scene))
    return examples_along(
        scene.name,
        seed,
        config,
        mission.events(),
        lambda: mission.truth()["objects"],
        usual=False,
        thinning=OF_DRAWN,
    )


def examples_along(
    name: str,
    seed: int,
    config: Config,
    events: Iterable[SourceEvent],
    objects: Callable[[], Sequence[dict[str, Any]]],
    *,
    usual: bool,
    thinning: Thinning = OF_SCENES,
) -> list[Example]:
    """Collect all detections along a line whose truth is known once it has been passed.

    Parameters
    ----------
    name, seed
        Of the line.
    config
        Of the payload; every place is measured whatever it says.
    events
        Pings and navigation of the line.
    objects
        Returns the truth's objects, after the last event.
    usual
        See Example.
    thinning
        Of faint detections.
    """
    found: list[Detection] = []

    def keep(detection: Detection) -> Detection:
        found.append(detection)
        return detection

    pipeline = Pipeline(_looking_at_everything(config), look=keep)
    for event in events:
        pipeline.feed(event)
    pipeline.finish()
    beam_width_rad = config.sonar.beam_width_rad
    examples = []
    for detection, known in zip(found, _labels_of(found, objects(), thinning), strict=True):
        if known is None or detection.surroundings is None:
            continue
        looked = examine(detection, region_of(detection, detection.surroundings, beam_width_rad), None, 0.0)
        seen = detection_details(detection)
        details: dict[LookStep, Features] = {"detector": seen, "contours": seen, "shape": looked.details}
        examples.append(
            Example(
                name,
                seed,
                usual,
                known.is_target,
                known.weight,
                detector_features(detection),
                looked.contour_features,
                looked.features,
                details,
                known.on_object,
            )
        )
    return examples


def look_table(examples: Sequence[Example]) -> LookTable:
    """Lay examples out as arrays."""
    usual, is_target, on_object = (
        np.array([getattr(example, name) for example in examples], dtype=np.bool_)
        for name in ("usual", "is_target", "on_object")
    )
    weight = np.array([example.weight for example in examples])
    return LookTable(usual, is_target, on_object, weight, {step: _step_table(examples, step) for step in STEPS})


def _step_table(examples: Sequence[Example], step: LookStep) -> StepTable:
    if not examples:
        return StepTable((), 0, np.empty((0, 0)))
    summed = tuple(getattr(examples[0], step))
    names = tuple(dict.fromkeys((*summed, *examples[0].details[step])))
    values = np.empty((len(examples), len(names)))
    for row, example in enumerate(examples):
        known = getattr(example, step) | example.details[step]
        values[row] = [known[name] for name in names]
    return StepTable(names, len(summed), values)


def fit_odds(examples: Sequence[Example], fitted_on: str, n_trees: Mapping[LookStep, int]) -> MineOdds:
    """Fit weights to examples, as fit_table does."""
    return fit_table(look_table(examples), fitted_on, n_trees)


def fit_table(looks: LookTable, fitted_on: str, n_trees: Mapping[LookStep, int]) -> MineOdds:
    """Fit weights for each step, and the requested number of trees; p_mine is right on average over the usual examples.

    Raises UsageError if there are no targets, or nothing else, among those.
    """
    usual, is_target, _, weight, _ = looks
    if not is_target[usual].any() or is_target[usual].all():
        n_targets, n_usual = np.count_nonzero(is_target & usual), np.count_nonzero(usual)
        raise UsageError(f"{fitted_on}: {n_targets} targets in {n_usual} detections. Fly more missions, with --seeds")
    prior = math.log(float(weight[is_target & usual].sum()) / float(weight[~is_target & usual].sum()))
    steps = {step: fit_step(looks, step, n_trees[step], looks.at(usual)) for step in STEPS}
    return MineOdds(fitted_on=fitted_on, prior=round(prior, _DIGITS), **steps)


def fit_step(looks: LookTable, step: LookStep, n_trees: int, usual: LookTable) -> Weights:
    """Fit the weights and trees of one step; p_mine is right on average over `usual`, which has targets and others."""
    _, is_target, _, weight, tables = looks
    table = tables[step]
    sums = _fit_sum(table, is_target, weight)
    start = log_odds_of(sums, table)
    weights = msgspec.structs.replace(sums, trees=_fit_trees(table, start, is_target, weight, n_trees))
    offset = weights.offset + _shift(log_odds_of(weights, usual.steps[step]), usual.is_target, usual.weight)
    return msgspec.structs.replace(weights, offset=round(offset, _DIGITS))


def fit_from_missions(
    out: Path,
    *,
    detector: Detector,
    n_seeds: int,
    n_crowded: int,
    n_drawn: int,
    first_seed: int,
    n_workers: int,
    show: Callable[[int, int], None] = lambda done, of: None,
) -> None:
    """Fly missions, fit the weights to what became of their detections, and write them to `out`, JSON.

    Prints how they do.

    Parameters
    ----------
    detector
        Whose detections to weigh.
    n_seeds
        Missions per scene, from `first_seed` on.
    n_crowded
        Further ones with CROWD times as many mines and rocks.
    n_drawn
        Missions of the wide world beside those.
    n_workers
        Missions flown at once.
    show
        Takes the missions flown so far, and how many there are.

    Raises
    ------
    UsageError
        For an `out` that cannot be written, before any work, and if there are no targets among the detections.
    """
    if not out.parent.is_dir():
        raise UsageError(f"--out {out}: there is no folder {out.parent}. Make it first")
    if out.is_dir():
        raise UsageError(f"--out {out} cannot be written: it is a folder. Name a file")
    make_directory(out.parent)
    seeds = range(first_seed, first_seed + n_seeds)
    scenes = [name for name in SCENES if detector == "contrast" or name not in HELD_OUT]
    first_crowd = first_seed + max(CROWD_SEEDS, n_seeds)
    crowds = range(first_crowd, first_crowd + n_crowded)
    tasks = [
        (name, seed, detector, crowd)
        for chunk, crowd in ((seeds, 1), (crowds, CROWD))
        for seed in chunk
        for name in scenes
    ]
    first_drawn = first_seed + DRAWN_SEEDS
    drawn = range(first_drawn, first_drawn + n_drawn)
    n_missions = len(tasks) + n_drawn
    examples: list[Example] = []
    with ProcessPoolExecutor(min(n_workers, n_missions), mp_context=get_context("spawn")) as pool:
        of_scenes = pool.map(examples_of, *zip(*tasks, strict=True))
        of_drawn = pool.map(examples_of_drawn, drawn, [detector] * n_drawn)
        for done, found in enumerate(chain(of_scenes, of_drawn), 1):
            examples += found
            show(done, n_missions)
    # Contrasts serve sonars unlike those simulated, where trees that have learnt simulated ones do worse than sums.
    n_trees = N_TREES if detector == "cascade" else _NO_TREES
    odds = fit_odds(examples, odds_fit_words(len(examples), scenes, seeds, crowds, n_drawn), n_trees)
    try:
        write_file(out, written(odds))
    except OSError as error:
        raise UsageError(f"--out {out} cannot be written: {error.strerror}") from error
    _report(examples, n_trees)


def odds_fit_words(n_examples: int, scenes: Sequence[str], seeds: range, crowds: range, n_drawn: int) -> str:
    """Describe the missions that weights were fitted on."""
    words = f"{n_examples} detections of simulated missions: {', '.join(scenes)}; seeds {seeds[0]} to {seeds[-1]}"
    if crowds:
        words += f", and {crowds[0]} to {crowds[-1]} with {CROWD} times as many mines and rocks"
    return f"{words}; {n_drawn} drawn from the wide world" if n_drawn else words


def written(odds: MineOdds) -> bytes:
    """Format JSON with a line per weight and per tree."""
    entries: dict[str, Any] = {"fitted_on": odds.fitted_on, "prior": odds.prior}
    parts = [f' "{name}": {json.dumps(value)}' for name, value in entries.items()]
    for step in STEPS:
        weighed: Weights = getattr(odds, step)
        weights = ",\n".join(f"   {json.dumps(name)}: {value!r}" for name, value in weighed.weights.items())
        trees = ",\n".join(f"   {msgspec.json.encode(tree).decode()}" for tree in weighed.trees)
        parts.append(
            f' "{step}": {{\n  "offset": {weighed.offset!r},\n  "weights": {{\n{weights}\n  }},\n  "trees": '
            f"[\n{trees}\n  ]\n }}"
        )
    return ("{\n" + ",\n".join(parts) + "\n}\n").encode()


def _looking_at_everything(config: Config) -> Config:
    confirm = msgspec.structs.replace(config.confirm, min_p_mine=0.0, max_per_tile=100_000)
    return reporting_everything(msgspec.structs.replace(config, confirm=confirm))


def _labels_of(
    detections: Sequence[Detection], objects: Sequence[dict[str, Any]], thinning: Thinning
) -> list[_Label | None]:
    """Label each detection by the truth; None for those that are not looked at."""
    if not detections:
        return []
    frame = LocalFrame(latitude_deg=detections[0].latitude_deg, longitude_deg=detections[0].longitude_deg)
    places = np.array([frame.to_enu(d.latitude_deg, d.longitude_deg, 0.0)[:2] for d in detections])
    scene_objects = np.array(
        [frame.to_enu(scene_object["lat"], scene_object["lon"], 0.0)[:2] for scene_object in objects]
    ).reshape(-1, 2)
    sizes = np.array([max(scene_object["length_m"], scene_object["width_m"]) for scene_object in objects])
    sigma_m = np.sqrt([max(float(np.linalg.eigvalsh(d.covariance_m2)[-1]), 0.0) for d in detections])
    distance_m = (
        np.hypot(*(places[:, np.newaxis] - scene_objects).transpose(2, 0, 1))
        if len(objects)
        else np.full((len(detections), 1), np.inf)
    )
    nearest = distance_m.argmin(axis=1)
    on_object = distance_m.min(axis=1) <= gates_m(_GATE_M, sigma_m)
    best: dict[tuple[int, str, int], int] = {}
    for index, detection in enumerate(detections):
        if on_object[index]:
            key = int(nearest[index]), detection.side, round(detection.time_s / _PASSAGE_S)
            if key not in best or detection.p_mine > detections[best[key]].p_mine:
                best[key] = index
    stands_for_it = set(best.values())
    labels: list[_Label | None] = []
    for index, detection in enumerate(detections):
        stands = index in stands_for_it
        beside = bool(on_object[index]) or bool(len(objects) and (distance_m[index] < _CLEAR_M + 0.5 * sizes).any())
        thins = detection.p_mine < _FAINT_P and not (stands and thinning.spares_objects)
        if (beside and not stands) or (thins and detection.ping_number % thinning.kept):
            labels.append(None)
            continue
        is_target = stands and bool(objects[int(nearest[index])]["is_target"])
        labels.append(_Label(is_target, stands, float(thinning.kept) if thins else 1.0))
    return labels


def _fit_sum(table: StepTable, is_target: NDArray[np.bool_], weight: Array) -> Weights:
    """Fit a logistic regression on standardised features, with a ridge so that redundant ones share their weight."""
    names, values = table.names[: table.n_summed], table.values[:, : table.n_summed]
    mean = np.average(values, axis=0, weights=weight)
    scale = np.sqrt(np.average((values - mean) ** 2, axis=0, weights=weight))
    used = np.ptp(values, axis=0) > 0.0  # rounding gives what never varies a scale of its own
    columns = np.column_stack([(values - mean) / np.where(used, scale, 1.0), np.ones(len(values))])
    found = _logistic(columns, is_target.astype(np.float64), weight)
    slopes = np.where(used, found[:-1] / np.where(used, scale, 1.0), 0.0)
    offset = float(found[-1] - slopes @ mean)
    return Weights(
        offset=round(offset, _DIGITS),
        weights={name: round(float(slope), _DIGITS) for name, slope in zip(names, slopes, strict=True)},
    )


def _fit_trees(
    table: StepTable, start: Array, is_target: NDArray[np.bool_], weight: Array, n_trees: int
) -> tuple[Tree, ...]:
    """Fit trees that add to the log-odds `start` what they miss."""
    return tuple(
        Tree(
            ask=tuple(
                (table.names[column], _rounded(at))
                for column, at in zip(tree.feature, tree.threshold.tolist(), strict=True)
            ),
            nats=tuple(round(nats, _DIGITS) for nats in tree.nats.tolist()),
        )
        for tree in trees.boost(table.values, is_target, weight, start, n_trees)
    )


def _shift(odds: Array, is_target: NDArray[np.bool_], weight: Array) -> float:
    """Return the offset to log-odds (n,) with which their probabilities add up to the number of targets."""
    from scipy.optimize import brentq

    n_targets = float(weight[is_target].sum())

    def too_many(shift: float) -> float:
        return float(weight @ np.exp(-np.logaddexp(0.0, -(odds + shift)))) - n_targets

    return float(brentq(too_many, -_MAX_SHIFT, _MAX_SHIFT, xtol=1e-9))


def log_odds_of(weights: Weights, table: StepTable) -> Array:
    """Return (n,) results of `weights.log_odds` for each row, all at once and to the same bits."""
    column = {name: number for number, name in enumerate(table.names)}
    values = table.values
    weighed = np.zeros(len(values))
    for name, weight in weights.weights.items():
        weighed += weight * values[:, column[name]]
    total = weights.offset + weighed
    for tree in weights.trees:
        asked, thresholds = zip(*tree.ask, strict=True)
        grown = trees.GrownTree(np.array([column[name] for name in asked]), np.array(thresholds), np.array(tree.nats))
        total += grown.nats[trees.leaves(grown, values)]
    return total


def _rounded(value: float) -> float:
    """Round to as many significant digits as separate neighbouring values."""
    return float(f"{value:.{_DIGITS + 2}g}")


def _logistic(columns: Array, target: Array, weight: Array) -> Array:
    """Return (k,) coefficients of the minimum log-loss plus ridge for columns (n, k), the last of which is the constant
    and goes free.
    """
    from scipy.optimize import minimize

    ridge = np.full(columns.shape[1], _RIDGE)
    ridge[-1] = 0.0

    def loss(at: Array) -> tuple[float, Array]:
        odds = columns @ at
        value = float(weight @ (np.logaddexp(0.0, odds) - target * odds) + 0.5 * ridge @ at**2)
        return value, columns.T @ (weight * (np.exp(-np.logaddexp(0.0, -odds)) - target)) + ridge * at

    return np.asarray(minimize(loss, np.zeros(columns.shape[1]), jac=True, method="BFGS", options={"gtol": 1e-4}).x)


def _report(examples: Sequence[Example], n_trees: Mapping[LookStep, int]) -> None:
    """Report the worth of each step on left-out scenes, every scene as it is judged with the weights of all
    others; and what more missions would bring.
    """
    usual = [example for example in examples if example.usual]
    is_target, weight = _labels(usual)
    p = {step: np.zeros(len(usual)) for step in STEPS}
    for scene in sorted({example.scene for example in usual}):
        inside = [example for example in usual if example.scene == scene]
        others = fit_odds([example for example in examples if example.scene != scene], "others", n_trees)
        at = np.array([example.scene == scene for example in usual])
        for step in STEPS:
            p[step][at] = _p_mine(others, step, inside)
    raw = 1.0 / (1.0 + np.exp([-example.detector["detector_odds"] for example in usual]))
    print(
        f"{is_target.sum()} looks at targets, {weight[~is_target].sum():.0f} others; each scene judged with the "
        "weights of the others\n"
    )
    print(f"{'':<24}others above the p_mine that this share of targets reaches")
    print(f"{'step':<24}{''.join(f'{share:>9.0%}' for share in _SHARES)}{'calibration error':>20}")
    for name, values in (("detector as it is", raw), *p.items()):
        repeated = np.repeat(np.arange(len(values)), weight.astype(int))
        error = calibration_error(values[repeated], is_target[repeated])
        print(f"{name:<24}{_above(values, is_target, weight)}{error:>20.4f}")
    _report_learning(examples, n_trees)


def _report_learning(examples: Sequence[Example], n_trees: Mapping[LookStep, int]) -> None:
    """Report missions of the last seed as they are, judged with weights from a part of the other seeds of every
    scene."""
    seeds, crowds = (
        sorted({example.seed for example in examples if example.usual is usual}) for usual in (True, False)
    )
    *seeds, last = seeds
    judged = [example for example in examples if example.usual and example.seed == last]
    is_target, weight = _labels(judged)
    if not seeds or not is_target.any():
        return
    print(f"\nseed {last}, {is_target.sum()} looks at targets, judged with the weights of other seeds, all steps\n")
    print(f"{'looks at targets':<24}others above the p_mine that this share of targets reaches")
    print(f"{'learned from':<24}{''.join(f'{share:>9.0%}' for share in _SHARES)}")
    for part in _PARTS:
        learned = {seed for some in (seeds, crowds) for seed in some[: math.ceil(part * len(some))]}
        some = [example for example in examples if example.seed in learned]
        values = _p_mine(fit_odds(some, "a part", n_trees), "shape", judged)
        print(f"{sum(example.is_target for example in some):<24}{_above(values, is_target, weight)}")


def _labels(examples: Sequence[Example]) -> tuple[NDArray[np.bool_], Array]:
    """Return which are targets, and how many each stands for, (n,)."""
    return np.array([example.is_target for example in examples]), np.array([example.weight for example in examples])


def _p_mine(odds: MineOdds, step: LookStep, examples: Sequence[Example]) -> Array:
    """Return (n,) p_mine of each example by itself."""
    log_odds = log_odds_of(getattr(odds, step), _step_table(examples, step))
    return np.asarray(np.exp(-np.logaddexp(0.0, -log_odds)))


def _above(p_mine: Array, is_target: NDArray[np.bool_], weight: Array) -> str:
    """Count the others above the p_mine that each of _SHARES of the targets reaches."""
    thresholds_by_share = np.quantile(p_mine[is_target], 1.0 - np.array(_SHARES))
    return "".join(f"{weight[~is_target & (p_mine >= at)].sum():>9.0f}" for at in thresholds_by_share)
