"""Fit the weights with which confirmation turns what it measures into the odds of a mine.

Detections of missions whose truth is known are examples. Of the cascade's, what the detector measured is weighed,
beside the verifier; of contrasts every step of the look is taken, whatever the odds. A target is the most mine-like
detection within the gate of one, per side and passage; further detections of it count for nothing, and all others are
the clutter to separate mines from. The examples of usual missions give the rarity of mines.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.details import detection_details
from auv_mcm.classify.features import Features, detector_features
from auv_mcm.classify.odds import MineOdds, Tree, Weights
from auv_mcm.confirm.region import Region
from auv_mcm.confirmation import examine, region_of
from auv_mcm.errors import UsageError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Detection, Detector, MeasuredStep, SourceEvent
from auv_mcm.settings.config import Config
from sim_replay.fitting.cascade import trees
from sim_replay.fitting.wide_world import wide_scene
from sim_replay.missions import reporting_everything
from sim_replay.scoring.matching import gates_m
from sim_replay.simulator.objects import place_objects
from sim_replay.simulator.scene import Scene, TargetKind

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
_FAINT_P: Final = 0.03  # the detector's p_mine below which detections on no object are thinned
_FAINT_KEPT: Final = 12  # one in so many: two in three are faint, and a look costs as much for each
_RIDGE: Final = 2.0  # of the logistic regression, per feature of unit variance
_DIGITS: Final = 5  # decimals in the file
_MAX_SHIFT: Final = 50.0  # nats
N_TREES: Final = 200
"""Trees that weigh what the detector measured of the cascade's detections."""
STEPS: Final[tuple[MeasuredStep, ...]] = ("detector", "contours", "shape")
LAST_STEP: Final[Mapping[Detector, MeasuredStep]] = {"cascade": "detector", "contrast": "shape"}
"""Steps that measurements decide, up to this one."""


class Example(NamedTuple):
    """Hold a detection with the measurements of every step, and its label.

    details: of the detector, what only trees weigh. contours, shape: empty for detections of the cascade. weight: how
    many it stands for. usual: of a mission with as many objects as its scene has, so that it shows how rare mines are.
    """

    usual: bool
    is_target: bool
    weight: float
    detector: Features
    contours: Features
    shape: Features
    details: Features


class StepTable(NamedTuple):
    """Hold what a step measured of n detections: values (n, k) by name, of which sums weigh the first n_summed."""

    names: tuple[str, ...]
    n_summed: int
    values: Array


class LookTable(NamedTuple):
    """Hold examples as arrays, (n,) each, and a table per step; fields as in Example."""

    usual: NDArray[np.bool_]
    is_target: NDArray[np.bool_]
    weight: Array
    steps: Mapping[MeasuredStep, StepTable]

    def at(self, chosen: NDArray[np.bool_]) -> LookTable:
        """Take the chosen examples, (n,) bool."""
        steps = {step: table._replace(values=table.values[chosen]) for step, table in self.steps.items()}
        return LookTable(self.usual[chosen], self.is_target[chosen], self.weight[chosen], steps)


class Label(NamedTuple):
    """Hold what a detection is by the truth; fields as in Example."""

    is_target: bool
    weight: float
    nearest: int  # object


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


def drawn_scene(seed: int) -> Scene:
    """Draw a mission of the wide world, with twice as many mines and stones where there is room for them."""
    scene = wide_scene(seed)
    crowd = crowded(scene, _DRAWN_CROWD)
    try:
        place_objects(crowd)
    except UsageError:
        return scene
    return crowd


def examples_along(
    config: Config,
    events: Iterable[SourceEvent],
    objects: Callable[[], Sequence[dict[str, Any]]],
    *,
    usual: bool,
    detector: Detector,
) -> list[Example]:
    """Collect all detections along a line whose truth is known once it has been passed.

    Parameters
    ----------
    config
        Of the payload; every place is measured whatever it says.
    events
        Pings and navigation of the line.
    objects
        Returns the truth's objects, after the last event.
    usual
        See Example.
    detector
        Whose detections they are.
    """
    examples = []
    for detection, region, known in labelled_regions(config, events, objects):
        contours, shape = dict[str, float](), dict[str, float]()
        if LAST_STEP[detector] == "shape":
            looked = examine(detection, region, None, 0.0)
            contours, shape = looked.contour_features, looked.features
        measured = detector_features(detection), contours, shape, detection_details(detection)
        examples.append(Example(usual, known.is_target, known.weight, *measured))
    return examples


def labelled_regions(
    config: Config, events: Iterable[SourceEvent], objects: Callable[[], Sequence[dict[str, Any]]]
) -> Iterator[tuple[Detection, Region, Label]]:
    """Find the detections that are examples, in order, each with the sea floor around it; see `examples_along`."""
    found = _all_detections(config, events)
    for detection, known in zip(found, _labels_of(found, objects()), strict=True):
        if known is not None and detection.surroundings is not None:
            yield detection, region_of(detection, detection.surroundings, config.sonar.beam_width_rad), known


def looks_at_targets(
    config: Config, events: Iterable[SourceEvent], objects: Callable[[], Sequence[dict[str, Any]]]
) -> list[tuple[Detection, dict[str, Any]]]:
    """Collect the detection that stands for each passage of a target, with the target; see `examples_along`."""
    found = _all_detections(config, events)
    known = objects()
    return [
        (detection, known[label.nearest])
        for detection, label in zip(found, _labels_of(found, known), strict=True)
        if label is not None and label.is_target
    ]


def _all_detections(config: Config, events: Iterable[SourceEvent]) -> list[Detection]:
    """Collect all detections along a line, with their surroundings."""
    found: list[Detection] = []

    def keep(detection: Detection) -> Detection:
        found.append(detection)
        return detection

    pipeline = Pipeline(_looking_at_everything(config), look=keep)
    for event in events:
        pipeline.feed(event)
    pipeline.finish()
    return found


def look_table(examples: Sequence[Example]) -> LookTable:
    """Lay examples out as arrays."""
    usual, is_target = (
        np.array([getattr(example, name) for example in examples], dtype=np.bool_) for name in ("usual", "is_target")
    )
    weight = np.array([example.weight for example in examples])
    return LookTable(usual, is_target, weight, {step: _step_table(examples, step) for step in STEPS})


def _step_table(examples: Sequence[Example], step: MeasuredStep) -> StepTable:
    if not examples:
        return StepTable((), 0, np.empty((0, 0)))
    summed = tuple(getattr(examples[0], step))
    details = [example.details if step == "detector" else {} for example in examples]
    names = tuple(dict.fromkeys((*summed, *details[0])))
    values = np.empty((len(examples), len(names)))
    for row, (example, detail) in enumerate(zip(examples, details, strict=True)):
        known = getattr(example, step) | detail
        values[row] = [known[name] for name in names]
    return StepTable(names, len(summed), values)


def fit_table(looks: LookTable, fitted_on: str, n_trees: int = 0) -> MineOdds:
    """Fit weights for each step, or trees for the detector alone; p_mine is right on average over the usual examples.

    Odds of trees have to get a verifier. Raises UsageError if there are no targets, or nothing else, among those.
    """
    usual, is_target, weight, _ = looks
    if not is_target[usual].any() or is_target[usual].all():
        n_targets, n_usual = np.count_nonzero(is_target & usual), np.count_nonzero(usual)
        raise UsageError(f"{fitted_on}: {n_targets} targets in {n_usual} detections. Fly more missions, with --seeds")
    prior = math.log(float(weight[is_target & usual].sum()) / float(weight[~is_target & usual].sum()))
    steps = {step: fit_step(looks, step, n_trees, looks.at(usual)) for step in (STEPS[:1] if n_trees else STEPS)}
    return MineOdds(fitted_on=fitted_on, prior=round(prior, _DIGITS), **steps)  # type: ignore[arg-type]


def fit_step(looks: LookTable, step: MeasuredStep, n_trees: int, usual: LookTable) -> Weights:
    """Fit one step: a sum of features, or trees; p_mine is right on average over `usual`, which has targets and others.

    Trees start from a constant: after a sum, Pd at 100 false alarms per km² is lower by 0.02 on domains left out.
    """
    _, is_target, weight, tables = looks
    table = tables[step]
    if n_trees:
        offset = math.log(float(weight[is_target].sum()) / float(weight[~is_target].sum()))
        grown = _fit_trees(table, np.full(len(weight), offset), is_target, weight, n_trees)
        weights = Weights(offset=round(offset, _DIGITS), weights={}, trees=grown)
    else:
        weights = _fit_sum(table, is_target, weight)
    offset = weights.offset + offset_of(log_odds_of(weights, usual.steps[step]), usual.is_target, usual.weight)
    return msgspec.structs.replace(weights, offset=round(offset, _DIGITS))


def written(odds: MineOdds) -> bytes:
    """Format JSON with a line per weight and per tree."""
    entries: dict[str, Any] = {"fitted_on": odds.fitted_on, "made_by": odds.made_by, "prior": odds.prior}
    entries |= {"fitted_for": odds.fitted_for} if odds.fitted_for else {}
    parts = [f' "{name}": {json.dumps(value)}' for name, value in entries.items()]
    if odds.recalibrated is not None:
        parts.append(f' "recalibrated": {msgspec.json.encode(odds.recalibrated).decode()}')
    if odds.verifier is not None:
        entry = msgspec.json.format(msgspec.json.encode(odds.verifier), indent=1).decode().replace("\n", "\n ")
        parts.append(f' "verifier": {entry}')
    for step in STEPS:
        weighed: Weights | None = getattr(odds, step)
        if weighed is None:
            continue
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


def _labels_of(detections: Sequence[Detection], objects: Sequence[dict[str, Any]]) -> list[Label | None]:
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
    best: dict[int, int] = {}
    for index, passage in enumerate(passages_of(detections, nearest, on_object).tolist()):
        if passage >= 0 and (passage not in best or detections[index].p_mine > detections[best[passage]].p_mine):
            best[passage] = index
    stands_for_it = set(best.values())
    labels: list[Label | None] = []
    for index, detection in enumerate(detections):
        stands = index in stands_for_it
        beside = bool(on_object[index]) or bool(len(objects) and (distance_m[index] < _CLEAR_M + 0.5 * sizes).any())
        thins = detection.p_mine < _FAINT_P and not stands
        if (beside and not stands) or (thins and detection.ping_number % _FAINT_KEPT):
            labels.append(None)
            continue
        is_target = stands and bool(objects[int(nearest[index])]["is_target"])
        labels.append(Label(is_target, float(_FAINT_KEPT) if thins else 1.0, int(nearest[index])))
    return labels


def passages_of(
    detections: Sequence[Detection], nearest: NDArray[np.integer], on_object: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Number the passages of objects, (n,): detections of one object and side without a pause; -1 on no object."""
    passages = np.full(len(detections), -1, dtype=np.int64)
    latest: dict[tuple[int, str], tuple[float, int]] = {}
    n_passages = 0
    for index in sorted(np.flatnonzero(on_object).tolist(), key=lambda index: detections[index].time_s):
        detection = detections[index]
        key = int(nearest[index]), detection.side
        before_s, passage = latest.get(key, (-math.inf, -1))
        if detection.time_s - before_s > _PASSAGE_S:
            passage, n_passages = n_passages, n_passages + 1
        passages[index], latest[key] = passage, (detection.time_s, passage)
    return passages


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
                (table.names[column], _rounded(at), no, yes)
                for column, at, (no, yes) in zip(
                    tree.feature, tree.threshold.tolist(), tree.leads.tolist(), strict=True
                )
            ),
            nats=tuple(round(nats, _DIGITS) for nats in tree.nats.tolist()),
        )
        for tree in trees.boost(table.values, is_target, weight, start, n_trees)
    )


def offset_of(odds: Array, is_target: NDArray[np.bool_], weight: Array) -> float:
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
        grown = trees.GrownTree(
            np.array([column[name] for name, *_ in tree.ask], dtype=np.int64),
            np.array([at for _, at, *_ in tree.ask]),
            np.array([leads for *_, no, yes in tree.ask for leads in (no, yes)], dtype=np.int64).reshape(-1, 2),
            np.array(tree.nats),
        )
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
