"""Confirm detections that may be mines, one by one: the stage between suppression and the ledger.

    detector's odds -> verifier -> contours -> Markov field, contours again from its labels -> solids -> belief

A detection whose odds have become too low goes no further. The verifier, a network, decides p_mine; contours, field and
solids then outline, size and classify what somebody will look at, and leave no evidence in the shadow of another
object, where nothing can be seen. Odds without a verifier are decided by what contours
and solids measure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, Literal, NamedTuple, TypeAlias

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import FRAME, dempster, vacuous
from auv_mcm.classify.chips import chip_of, chips_beside
from auv_mcm.classify.details import detection_details
from auv_mcm.classify.evidence import TEMPERATURE, ClassEvidence, view_mass
from auv_mcm.classify.features import (
    Features,
    contour_features,
    detector_features,
    outline_features,
    shape_features,
    with_shape,
)
from auv_mcm.classify.fit import USUAL_RANGES, Effort, SearchRanges, ShapeFit, ShapeFits, fit_to
from auv_mcm.classify.likelihood import image_row_sums, labels_cost_of
from auv_mcm.classify.odds import MineOdds, with_ratio
from auv_mcm.classify.size_evidence import NO_WEIGHT, SizeEvidence, SizeWeight, size_evidence
from auv_mcm.classify.targets import shipped_targets
from auv_mcm.classify.verifier import MINE_KINDS, NO_OPINION, Opinion, mean_scores, network_of, opinions_of
from auv_mcm.confirm.mrf import Segmentation, segment
from auv_mcm.confirm.region import BACKGROUND, HIGHLIGHT, SHADOW, Region, require_sound
from auv_mcm.confirm.snake import Contours, converge_on, start_from_labels, survey
from auv_mcm.confirm.snake_rules import contour_mask
from auv_mcm.confirm.speckle import grain_area
from auv_mcm.kernels.shape import ImageRowSums
from auv_mcm.records import Confirmation, ContactClass, Detection, LookStep, MeasuredStep, ShapeModel, Surroundings
from auv_mcm.settings.config import ConfirmConfig
from auv_mcm.skips import NO_SKIPS, Skips
from auv_mcm.snippet import unpack_snippet

_QUALITY: Final = 0.95  # of a view that nothing speaks against
_POOR_QUALITY: Final = 0.6  # reliability of a poor view, where a good one has _QUALITY; chosen, not measured
_POOR: Final = frozenset({"in_turn", "bottom_not_seen", "cut_off", "altitude"})
_NOT_LISTED: Final = -0.5  # nats by the mines expected from which the reasons say so: a third of the odds
CLOSE_LOOK_P: Final = 0.05  # p_mine from which a view gets a close look; asked of less likely ones, no call changed
_MIN_PIXELS: Final = 8  # along either axis; contours need as many
_SEARCH_M: Final = 0.7  # from the detection to the labels that are its
ExaminationStep: TypeAlias = Literal["survey", "first contours", "field", "second contours", "solids", "features"]

_NONE: Final = np.empty((0, 2))
_NO_LABELS: Final = np.empty((0, 0), dtype=np.uint8)


class Examination(NamedTuple):
    """Hold the results of all steps for one detection; None for steps that were not taken.

    contour_features: of the first contours. features: of the last step taken.
    p_contours: p_mine after the first contours.
    """

    region: Region
    contours: Contours
    segmentation: Segmentation | None
    fits: ShapeFits | None
    contour_features: Features
    features: Features
    p_contours: float


def confirm_detection(
    detection: Detection,
    beam_width_rad: float,
    odds: MineOdds,
    config: ConfirmConfig,
    without_skips: Skips = NO_SKIPS,
    sizes: SizeEvidence | None = None,
    opinion: Opinion | None = None,
) -> Detection:
    """Return the detection with p_mine after confirmation, without surroundings.

    It has a Confirmation if its odds allowed one, and p_by_step has p_mine after each step. A detection that went no
    further than the detector has one of these reasons:
    `not_looked_at` (odds too low, by the detector or the verifier), `region_too_small`, `geometry_unknown` (altitude or
    range that no sonar can have).

    Parameters
    ----------
    without_skips
        Those that are switched off.
    sizes
        Of the mines expected; any if None.
    opinion
        Of `opinions_on`, where it is known already.
    """
    sizes = size_evidence(shipped_targets()) if sizes is None else sizes
    ratio = _detector_ratio(detection, odds)
    p_by_step: dict[LookStep, float] = {"detector": odds.p_mine(ratio)}
    surroundings = detection.surroundings
    if surroundings is None or (p_by_step["detector"] < config.min_p_mine and "detector-odds" not in without_skips):
        return _ended(detection, p_by_step, "not_looked_at")
    region = region_of(detection, surroundings, beam_width_rad)
    if (fault := _fault(region)) is not None:
        return _ended(detection, p_by_step, fault)
    min_p_mine = 0.0 if "contour-odds" in without_skips else config.min_p_mine
    verified = None
    if odds.verifier is not None:
        if opinion is None:
            (opinion,) = opinions_on([detection], beam_width_rad, odds)
        verified = odds.verified_ratio(ratio, opinion.nats)
        p_by_step["verifier"] = odds.p_mine(verified)
        if opinion is not NO_OPINION:
            detection = msgspec.structs.replace(detection, kind_nats=opinion.kind_nats)
        if p_by_step["verifier"] < max(config.min_p_mine, CLOSE_LOOK_P) and "verifier-odds" not in without_skips:
            return _ended(detection, p_by_step, "not_looked_at")
        min_p_mine = 0.0
    examination = examine(
        detection, region, odds, min_p_mine, refines_all="hopeless-solids" in without_skips, ranges=sizes.ranges
    )
    p_by_step["contours"] = examination.p_contours if verified is None else p_by_step["verifier"]
    log_ratio = evidence_of(examination, odds) if verified is None else verified
    weight = NO_WEIGHT
    if examination.fits is not None:
        weight = sizes.weigh(examination.fits)
        log_ratio = _seen(log_ratio + weight.nats, examination.contours)
        p_by_step["shape"] = odds.p_mine(log_ratio)
    found = _confirmation(detection, surroundings, examination, log_ratio, weight, opinion or NO_OPINION)
    p_mine = odds.p_mine(log_ratio)
    return msgspec.structs.replace(detection, p_mine=p_mine, p_by_step=p_by_step, surroundings=None, confirmation=found)


def is_worth_confirming(detection: Detection, odds: MineOdds, config: ConfirmConfig) -> bool:
    """Decide whether p_mine from the detector's measurements reaches the lowest that is confirmed."""
    return detector_p_mine(detection, odds) >= config.min_p_mine


def detector_p_mine(detection: Detection, odds: MineOdds) -> float:
    """Compute p_mine from the detector's measurements alone."""
    return odds.p_mine(_detector_ratio(detection, odds))


def without_confirmation(detection: Detection, p_mine: float, reason: str) -> Detection:
    """Return the detection with p_mine from the detector's measurements alone, and the reason why."""
    return _ended(detection, {"detector": p_mine}, reason)


def opinions_on(
    detections: Sequence[Detection], beam_width_rad: float, odds: MineOdds, most_again: int | None = None
) -> list[Opinion]:
    """Ask the verifier's network about detections with surroundings, all together, one opinion each.

    Where p_mine reaches 0.05, the opinion is the mean of four: of chips that lie a little off, too, and are mirrored;
    of the likeliest `most_again`, None for all. NO_OPINION on a detection whose region is too small or has no geometry.
    Raises ValueError for odds without a verifier.
    """
    if odds.verifier is None:
        raise ValueError("these odds have no verifier")
    network, other_nats = network_of(odds.verifier.digest, odds.verifier.file), odds.verifier.other_nats
    seen = [
        (one, region_of(one, one.surroundings, beam_width_rad)) for one in detections if one.surroundings is not None
    ]
    sound = [k for k, (_, region) in enumerate(seen) if _fault(region) is None]
    chips = [chip_of(seen[k][1]) for k in sound]
    scores = network.scores(chips)
    p_each = [
        odds.p_mine(odds.verified_ratio(_detector_ratio(seen[k][0], odds), opinion.nats))
        for k, opinion in zip(sound, opinions_of(scores, other_nats), strict=True)
    ]
    likely = sorted((n for n, p in enumerate(p_each) if p >= CLOSE_LOOK_P), key=lambda n: -p_each[n])
    asked_again = sorted(likely[:most_again])
    if asked_again:
        beside = [chip for n in asked_again for chip in chips_beside(seen[sound[n]][1], chips[n])]
        scores[asked_again] = mean_scores(scores[asked_again], network.scores(beside))
    found = dict(zip(sound, opinions_of(scores, other_nats), strict=True))
    return [found.get(k, NO_OPINION) for k in range(len(seen))]


def verified(detections: Sequence[Detection], beam_width_rad: float, odds: MineOdds) -> list[Detection]:
    """Return detections with p_mine after the verifier, without a Confirmation and without surroundings.

    For who cannot wait for outline, size and kind. Detections keep their order; each needs surroundings. Raises
    ValueError for odds without a verifier.
    """
    opinions = opinions_on(detections, beam_width_rad, odds)
    return [
        ended_at_verifier(one, opinion, odds, "not_looked_at")
        for one, opinion in zip(detections, opinions, strict=True)
    ]


def ended_at_verifier(detection: Detection, opinion: Opinion, odds: MineOdds, reason: str) -> Detection:
    """End confirmation with p_mine after the verifier, or the detector's where it has no opinion."""
    ratio = _detector_ratio(detection, odds)
    steps: dict[LookStep, float] = {"detector": odds.p_mine(ratio)}
    if opinion is not NO_OPINION:
        steps["verifier"] = odds.p_mine(odds.verified_ratio(ratio, opinion.nats))
        detection = msgspec.structs.replace(detection, kind_nats=opinion.kind_nats)
    return _ended(detection, steps, reason)


def _ended(detection: Detection, p_by_step: dict[LookStep, float], reason: str) -> Detection:
    """End confirmation with the p_mine of the last step taken."""
    *_, p_mine = p_by_step.values()
    return msgspec.structs.replace(
        detection, p_mine=p_mine, p_by_step=p_by_step, reasons=(*detection.reasons, reason), surroundings=None
    )


def _fault(region: Region) -> str | None:
    """Say why nothing can be seen in a region; None if something can."""
    if min(region.intensity.shape) < _MIN_PIXELS:
        return "region_too_small"
    try:
        require_sound(region)
    except ValueError:
        return "geometry_unknown"
    return None


def _detector_ratio(detection: Detection, odds: MineOdds) -> float:
    return odds.log_ratio("detector", detector_features(detection) | detection_details(detection))


def evidence_of(examination: Examination, odds: MineOdds) -> float:
    """Weigh the last step that was taken, in nats for a mine."""
    step: MeasuredStep = "contours" if examination.fits is None else "shape"
    return _ratio(step, examination.features, examination.contours, odds)


def _ratio(step: MeasuredStep, features: Features, contours: Contours, odds: MineOdds) -> float:
    """Compute the evidence in nats."""
    return _seen(odds.log_ratio(step, features), contours)


def _seen(ratio: float, contours: Contours) -> float:
    """Leave no evidence for a mine in the shadow of another object, where nothing can be seen."""
    return min(ratio, 0.0) if "in_shadow" in contours.reasons else ratio


def region_of(detection: Detection, surroundings: Surroundings, beam_width_rad: float) -> Region:
    """Cut out the region that confirmation works on."""
    return Region(
        intensity=unpack_snippet(surroundings.codes).astype(np.float64),
        valid=surroundings.codes > 0,
        row_spacing_m=detection.row_spacing_m,
        column_spacing_m=detection.column_spacing_m,
        first_ground_range_m=surroundings.first_ground_range_m,
        altitude_m=surroundings.first_return_m,
        row=surroundings.row,
        column=surroundings.column,
        beam_width_rad=beam_width_rad,
        squint_rad=detection.squint_rad,
    )


def examine(
    detection: Detection,
    region: Region,
    odds: MineOdds | None,
    min_p_mine: float,
    done: Callable[[ExaminationStep], None] = lambda step: None,
    refines_all: bool = False,
    ranges: SearchRanges = USUAL_RANGES,
) -> Examination:
    """Run the steps until p_mine falls below `min_p_mine`; all steps if `odds` is None.

    Odds with a verifier need no features: they stay empty, p_contours is NaN, and all steps are taken.

    Parameters
    ----------
    done
        Called after each step, for benches.
    refines_all
        With the beam also solids that are far behind.
    ranges
        Of the parameters of solids that are searched.
    """
    area = grain_area(region.intensity, region.valid)
    ground = survey(region, area)
    done("survey")
    contours = ground if isinstance(ground, Contours) else converge_on(ground, ground.boxes)
    done("first contours")
    before: Features = {}
    first: Features = {}
    p_contours = math.nan
    measures_features = odds is None or odds.verifier is None
    if measures_features:
        before = detector_features(detection)
        first = before | contour_features(contours) | outline_features(contours, region)
        if odds is not None:
            p_contours = odds.p_mine(_ratio("contours", first, contours, odds))
    done("features")
    if p_contours < min_p_mine:
        return Examination(region, contours, None, None, first, first, p_contours)
    segmentation = segment(region)
    done("field")
    own = labels_near(segmentation.labels, region)
    if own is not None and not isinstance(ground, Contours):
        again = converge_on(ground, start_from_labels(region, own))
        # Whichever start led to the better contours; a criterion that is not a number is no contour.
        if not contours.criterion <= again.criterion and not math.isnan(again.criterion):
            contours = again
    done("second contours")
    image = image_row_sums(region, area)
    fits = fit_to(image, region, contour_cost(image, region, contours, area), Effort(refines_all=refines_all), ranges)
    done("solids")
    features = first
    if measures_features:
        found = before | contour_features(contours) | outline_features(contours, region)
        features = with_shape(found, shape_features(fits, segmentation.labels))
    done("features")
    return Examination(region, contours, segmentation, fits, first, features, p_contours)


def labels_near(labels: NDArray[np.uint8], region: Region) -> NDArray[np.uint8] | None:
    """Keep the connected highlight and shadow labels with most pixels close to the detection.

    All else is background; None if none are. labels: (n_rows, n_columns) uint8.
    """
    n_parts, parts = cv2.connectedComponents((labels != BACKGROUND).astype(np.uint8), connectivity=8)
    window = []
    for centre, reach, size in (
        (region.row, _SEARCH_M / region.row_spacing_m, labels.shape[0]),
        (region.column, _SEARCH_M / region.column_spacing_m, labels.shape[1]),
    ):
        middle = min(max(int(centre), 0), size - 1)
        window.append(slice(max(middle - round(reach), 0), middle + round(reach) + 1))
    counts = np.bincount(parts[tuple(window)].ravel(), minlength=n_parts)
    counts[0] = 0
    if not counts.any():
        return None
    return np.where(parts == int(counts.argmax()), labels, np.uint8(BACKGROUND)).astype(np.uint8)


def contour_cost(image: ImageRowSums | None, region: Region, contours: Contours, correlation_area: float) -> float:
    """Weigh the free contours in nats, with the code length of their nodes, to compare with what solids cost.

    image: the region's `likelihood.image_row_sums`.
    """
    labels = np.zeros(region.intensity.shape, dtype=np.uint8)
    for nodes, label in ((contours.shadow, SHADOW), (contours.highlight, HIGHLIGHT)):
        labels[contour_mask(nodes, labels.shape)] = label
    n_nodes = len(contours.highlight) + len(contours.shadow)
    n_samples = float(region.valid.sum()) / correlation_area
    return labels_cost_of(image, region, labels) + 0.5 * n_nodes * math.log(max(n_samples, 1.0))


def shape_mass(
    fits: ShapeFits, poor: bool, weight: SizeWeight = NO_WEIGHT, opinion: Opinion = NO_OPINION
) -> NDArray[np.float64]:
    """Weigh which mines a view may show, (32,). Clutter is weighed from everything together instead.

    Parameters
    ----------
    poor
        Whether something speaks against the view.
    weight
        Of the mines expected; a kind that it makes less probable than the most expected one counts as that much less
        likely, before the masses are tempered.
    opinion
        Of the network, a source of its own, beside which solids count as of a poor view: of 100 called mines of eight
        scenes 82 have the right kind so, 78 with solids in full, 60 without the network.
    """
    highest = max(weight.factors.values(), default=1.0)
    evidence: dict[ContactClass, ClassEvidence] = {
        fit.solid: ClassEvidence(
            nll=fit.best.cost - TEMPERATURE * math.log(weight.factors.get(fit.solid, 1.0) / highest),
            plausibility=fit.plausibility,
        )
        for fit in fits.fits
    }
    asked = opinion != NO_OPINION
    mass = view_mass(evidence, _POOR_QUALITY if poor or asked else _QUALITY) if evidence else vacuous()
    if not asked:
        return mass
    nats = dict(zip(MINE_KINDS, opinion.kind_nats, strict=True))
    likeliest = max(nats[kind] for kind in FRAME if kind in nats)
    kinds = {kind: ClassEvidence(nll=TEMPERATURE * (likeliest - nats[kind])) for kind in FRAME if kind in nats}
    return dempster(np.stack([mass, view_mass(kinds, _POOR_QUALITY if poor else _QUALITY)])).mass


def _confirmation(
    detection: Detection,
    surroundings: Surroundings,
    examination: Examination,
    log_ratio: float,
    weight: SizeWeight,
    opinion: Opinion,
) -> Confirmation:
    contours, fits = examination.contours, examination.fits
    best = fits.fits[0] if fits is not None and fits.fits else None
    reasons = (*contours.reasons, *(() if fits is None else fits.flags), *(() if best is None else best.flags))
    if examination.segmentation is not None:
        reasons = (*reasons, *examination.segmentation.flags)
    if weight.nats <= _NOT_LISTED:
        reasons = (*reasons, "not_listed")
    all_reasons = frozenset((*detection.reasons, *reasons))
    mass = vacuous() if fits is None else shape_mass(fits, not all_reasons.isdisjoint(_POOR), weight, opinion)
    # Whole pixels lie between the two pictures.
    top = round(surroundings.row - detection.snippet_row)
    near = round(surroundings.column - detection.snippet_column)
    n_rows, n_columns = detection.snippet.shape
    corner = np.array([top, near], dtype=np.float64)
    labels = _NO_LABELS
    if examination.segmentation is not None:
        labels = np.ascontiguousarray(examination.segmentation.labels[top : top + n_rows, near : near + n_columns])
    return Confirmation(
        log_ratio=log_ratio,
        shape_mass=mass,
        mass=with_ratio(mass, log_ratio),
        half_turn_symmetric=best is None or best.solid != "wedge",
        labels=labels,
        highlight=contours.highlight - corner if len(contours.highlight) else _NONE,
        shadow=contours.shadow - corner if len(contours.shadow) else _NONE,
        model=None if best is None else _model(best, corner),
        rejected=contours.rejected,
        reasons=tuple(dict.fromkeys(reasons)),
        n_not_refined=0 if fits is None else sum(not fit.refined for fit in fits.fits),
    )


def _model(fit: ShapeFit, corner: NDArray[np.float64]) -> ShapeModel:
    shape = fit.best.shape
    starts, tops, stops = np.array(fit.ends).reshape(-1, 3).T
    sizes = {name: float(getattr(shape, name)) for name in shape.__struct_fields__}
    return ShapeModel(
        classification=fit.solid,
        sizes=sizes,
        sigma={name: value for name, value in fit.sigma.items() if name in sizes},
        highlight=_outline(starts, tops, corner),
        shadow=_outline(tops, stops, corner),
    )


def _outline(near: NDArray[np.float64], far: NDArray[np.float64], corner: NDArray[np.float64]) -> NDArray[np.float64]:
    """Draw an outline (n, 2) around the columns from near to far (n_rows,) of the rows that have any.

    It runs down the near side and up the far one.
    """
    rows = np.flatnonzero(far > near)
    if rows.size == 0:
        return _NONE
    edges = np.repeat(rows, 2) + np.tile([0.0, 1.0], rows.size)
    down = np.column_stack([edges, np.repeat(near[rows], 2)])
    up = np.column_stack([edges, np.repeat(far[rows], 2)])[::-1]
    return np.concatenate([down, up]) - corner
