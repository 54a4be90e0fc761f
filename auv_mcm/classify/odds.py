"""Compute the odds of a mine after each step of confirmation, and the belief mass that stands for them.

Each step weighs what has been measured so far. Detections of contrasts are weighed step by step by logistic regression
(D. R. Cox, J. Royal Statistical Society B 20, 1958), those of the cascade by boosted trees (J. H. Friedman, Annals of
Statistics 29, 2001) and then by the verifier; all are fitted on simulated missions with seeds that nothing is scored
on. The log-odds of mines among the detections fitted on are taken off: what is left is the evidence of the view alone,
a log-likelihood ratio. How rare mines are is put back once per contact, as one more source.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import MINES, Array, conjunctive, subset, vacuous
from auv_mcm.classify.verifier import network_of
from auv_mcm.errors import BadInputError
from auv_mcm.model_file import SHIPPED, read_model
from auv_mcm.records import Detector, MeasuredStep
from auv_mcm.settings.config import Config

# two views of 6 nats each that contradict each other have a conflict of 0.9, at which they are kept apart
_TEMPER: Final = 0.5
_RELIABILITY: Final = 0.999  # share of the mass that the odds commit; the rest stays unknown
_BOUND: Final = 12.0  # nats
_CLUTTER: Final = subset("clutter")


_Weight: TypeAlias = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
_Prior: TypeAlias = Annotated[float, msgspec.Meta(ge=-20.0, le=20.0)]
_Share: TypeAlias = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]


_MAX_QUESTIONS: Final = 63  # of a tree, far more than any was grown with

_Lead: TypeAlias = Annotated[int, msgspec.Meta(ge=-_MAX_QUESTIONS - 1, le=_MAX_QUESTIONS)]
_Question: TypeAlias = tuple[str, float, _Lead, _Lead]


class Tree(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Ask questions in turn; where they lead to adds to the log-odds.

    ask: name, threshold, and where no and yes lead to, yes if the feature is above: a later question, or leaf k for
    -1 - k. nats: of the leaves, one more than there are questions.
    """

    ask: Annotated[tuple[_Question, ...], msgspec.Meta(max_length=_MAX_QUESTIONS)]
    nats: Annotated[tuple[_Weight, ...], msgspec.Meta(min_length=1, max_length=_MAX_QUESTIONS + 1)]

    def __post_init__(self) -> None:
        led_to = sorted(lead for *_, no, yes in self.ask for lead in (no, yes))
        expected = [*range(-len(self.nats), 0), *range(1, len(self.ask))] if self.ask else []
        goes_back = any(0 <= lead <= place for place, (*_, no, yes) in enumerate(self.ask) for lead in (no, yes))
        if len(self.nats) != len(self.ask) + 1 or led_to != expected or goes_back:
            raise ValueError("a tree must lead to each leaf and each later question once")


class _Forest(NamedTuple):
    """Hold trees as arrays over their nodes, those of all trees in one row, leaves lead to themselves.

    feature: (n,) intp into names. threshold: (n,). leads: (2, n) intp, for no and yes. nats: (n,). roots: (n_trees,)
    intp. depth: most questions on one way.
    """

    names: tuple[str, ...]
    feature: NDArray[np.intp]
    threshold: Array
    leads: NDArray[np.intp]
    nats: Array
    roots: NDArray[np.intp]
    depth: int

    @classmethod
    def of(cls, trees: Sequence[Tree]) -> _Forest:
        names = tuple(dict.fromkeys(name for tree in trees for name, *_ in tree.ask))
        column = {name: k for k, name in enumerate(names)}
        feature: list[int] = []
        threshold: list[float] = []
        no: list[int] = []
        yes: list[int] = []
        nats: list[float] = []
        roots: list[int] = []
        depth = 0
        for tree in trees:
            first, n_asked = len(feature), len(tree.ask)
            place = {lead: first + (lead if lead >= 0 else n_asked - 1 - lead) for lead in range(-n_asked - 1, n_asked)}
            leaves = [place[-1 - k] for k in range(n_asked + 1)]
            roots.append(first)
            feature += [column[name] for name, *_ in tree.ask] + [0] * len(leaves)
            threshold += [at for _, at, *_ in tree.ask] + [0.0] * len(leaves)
            no += [place[lead] for *_, lead, _ in tree.ask] + leaves
            yes += [place[lead] for *_, lead in tree.ask] + leaves
            nats += [0.0] * n_asked + list(tree.nats)
            below = [0] * n_asked
            for question in reversed(range(n_asked)):
                below[question] = 1 + max((below[lead] for lead in tree.ask[question][2:] if lead >= 0), default=0)
            depth = max(depth, *below[:1], 0)
        places = functools.partial(np.array, dtype=np.intp)
        leads = places([no, yes])
        return cls(names, places(feature), np.array(threshold), leads, np.array(nats), places(roots), depth)

    def added_to(self, start: float, features: Mapping[str, float]) -> float:
        """Add the leaf of each tree in turn. Raises KeyError for a feature that is missing."""
        values = np.array([features[name] for name in self.names] or [0.0])
        led_to = np.where(values.take(self.feature) > self.threshold, self.leads[1], self.leads[0])
        place = self.roots
        for _ in range(self.depth):
            place = led_to.take(place)
        terms = np.concatenate(([start], self.nats.take(place)))
        return float(np.add.accumulate(terms)[-1])  # in order: numpy's own sum pairs its terms


class Weights(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True, dict=True):
    """Weigh features: log-odds = offset + sum of weight * feature + what each tree adds.

    A NaN is above no threshold.
    """

    offset: _Weight
    weights: dict[str, _Weight]
    trees: tuple[Tree, ...] = ()

    @functools.cached_property
    def _forest(self) -> _Forest:
        return _Forest.of(self.trees)

    def log_odds(self, features: Mapping[str, float]) -> float:
        """Add up the log-odds, tree after tree. Raises KeyError for a feature that is missing."""
        total = self.offset + sum(weight * features[name] for name, weight in self.weights.items())
        return self._forest.added_to(total, features) if self.trees else total


class Verification(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Weigh the verifier's network beside the detector's measurements.

    Log-odds = offset + detector * log-odds by the detector + network * ln(p(mine) / p(anything else)) by the network.
    other_nats: added to the network's score of other objects. digest: SHA-256 of the network's file. file: where it is,
    from the folder of the odds; empty for the one that ships. made_by, trained_on, calibrated_on: how it was made, what
    from, and what these weights were fitted on.
    """

    digest: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
    offset: _Weight
    detector: _Weight
    network: _Weight
    other_nats: _Weight
    file: str = ""
    made_by: str = ""
    trained_on: str = ""
    calibrated_on: str = ""

    def log_odds(self, detector_log_odds: float, network_nats: float) -> float:
        """Weigh both."""
        return self.offset + self.detector * detector_log_odds + self.network * network_nats

    def recalibrated(self, slope: float, offset_nats: float) -> Verification:
        """Weigh a detector whose log-odds, as the result's, became offset_nats + slope * log-odds."""
        return msgspec.structs.replace(
            self, offset=slope * self.offset + offset_nats * (1.0 - self.detector), network=slope * self.network
        )


class Recalibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Say how weights were changed by verdicts of people: log-odds became offset_nats + slope * log-odds.

    detector: whose odds they are. background_nats: by which the logarithm of the background's density changed.
    missions, n_mine_like, n_not_mine_like: what was judged. gain_nats, low_nats, high_nats: log-loss of a verdict less
    than before on missions left out, with its 95 % interval.
    """

    detector: Detector
    slope: Annotated[float, msgspec.Meta(ge=0.5, le=2.0)]
    offset_nats: Annotated[float, msgspec.Meta(ge=-10.0, le=10.0)]
    background_nats: Annotated[float, msgspec.Meta(ge=-5.0, le=5.0)]
    missions: tuple[str, ...]
    n_mine_like: int
    n_not_mine_like: int
    gain_nats: float
    low_nats: float
    high_nats: float


class MineOdds(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hold the weights of each step.

    prior: log-odds of a mine among the detections they were fitted on. fitted_on: what those were. made_by: version and
    command that make the same file again. left_out: of files of earlier versions; nothing reads it.
    recalibrated: None for weights that no verdict has changed. verifier: decides in place of contours and shape, which
    are not read then; None where those decide. fitted_for: whose detections, None for the weights that ship.
    """

    fitted_on: str
    made_by: str = ""
    prior: _Prior
    detector: Weights
    contours: Weights | None = None
    shape: Weights | None = None
    left_out: tuple[Any, ...] = ()
    recalibrated: Recalibration | None = None
    verifier: Verification | None = None
    fitted_for: Detector | None = None

    def verified_ratio(self, detector_ratio: float, network_nats: float) -> float:
        """Compute evidence in nats from the detector's and the network's, without the prior, at most 12 either way.

        Raises ValueError for odds without a verifier.
        """
        if self.verifier is None:
            raise ValueError("these odds have no verifier")
        odds = self.verifier.log_odds(detector_ratio + self.prior, network_nats)
        return min(max(odds - self.prior, -_BOUND), _BOUND)

    def log_ratio(self, step: MeasuredStep, features: Mapping[str, float]) -> float:
        """Compute evidence in nats for a mine against anything else, without the prior, at most 12 either way.

        features: all that the step was fitted with, and others perhaps. Raises ValueError if one of those is missing.
        """
        weighed: Weights | None = getattr(self, step)
        if weighed is None:
            raise ValueError(f"{step}: these odds are decided by the verifier")
        try:
            odds = weighed.log_odds(features)
        except KeyError as missing:
            raise ValueError(f"{step}: fitted with {missing}, called with {sorted(features)} alone") from missing
        return min(max(odds - self.prior, -_BOUND), _BOUND)

    def p_mine(self, log_ratio: float) -> float:
        """Compute the probability of a mine for one view's evidence."""
        return 1.0 / (1.0 + math.exp(-(log_ratio + self.prior)))


@functools.cache
def shipped_odds(detector: Detector) -> MineOdds:
    """Load the weights that ship with the package for detections of one of the detectors, once in a process."""
    name = f"mine_odds_{detector}.json"
    return parse_odds(resources.files("auv_mcm.classify").joinpath(name).read_bytes(), name)


def configured_odds(config: Config, detector: Detector) -> MineOdds:
    """Read the weights that `confirm.odds` names, for detections of the detector that serves.

    Raises BadInputError naming the file, for one that is damaged or of the other detector, for its network, and where
    gate and background belong to other weights: verdicts change those that ship, a fit makes new ones.
    """
    name = config.confirm.odds
    odds = read_model("confirm.odds", name, parse_odds, lambda: shipped_odds(detector))
    change = odds.recalibrated
    if name == SHIPPED:
        return odds
    if (fitted_for := odds.fitted_for if change is None else change.detector) != detector:
        raise BadInputError(
            f"confirm.odds {name}: it is for the {fitted_for or 'detector of another version'}, and the {detector} "
            f"serves here. Name a file of 'auv-mcm calibrate odds' for this configuration, or '{SHIPPED}'"
        )
    others = {"detect.gate": config.detect.gate, "contacts.background": config.contacts.background}
    if change is None and (unfitted := [key for key, value in others.items() if value == SHIPPED]):
        raise BadInputError(
            f"confirm.odds {name}: {' and '.join(unfitted)}: what ships belongs to the odds that ship. Name files that "
            "'auv-mcm calibrate gate' and 'auv-mcm calibrate background' wrote with this configuration, or 'none'"
        )
    if odds.verifier is None or not odds.verifier.file:
        return odds
    verifier = msgspec.structs.replace(odds.verifier, file=str(Path(name).absolute().parent / odds.verifier.file))
    network_of(verifier.digest, verifier.file)
    return msgspec.structs.replace(odds, verifier=verifier)


def parse_odds(data: bytes, place: str) -> MineOdds:
    """Parse weights from JSON. Raises BadInputError naming `place` and what is wrong with it."""
    again = "Write the file again with 'auv-mcm calibrate odds'"
    try:
        odds = msgspec.json.decode(data, type=MineOdds)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{place}: {error}. {again}") from error
    if odds.verifier is None and any(step is None or step.trees for step in (odds.contours, odds.shape)):
        raise BadInputError(f"{place}: without a verifier `contours` and `shape` have to be sums of weights. {again}")
    return odds


def share_of_ratio(log_ratio: float) -> float:
    """Compute the share of belief on a mine, 0..1, for evidence in nats.

    Tempered, so that few nats are not taken for certainty.
    """
    return 1.0 / (1.0 + math.exp(-_TEMPER * log_ratio))


def mass_of_ratio(log_ratio: float) -> Array:
    """Compute the (32,) mass on "a mine" and on "clutter" for evidence in nats; 0 nats favour neither."""
    mass = (1.0 - _RELIABILITY) * vacuous()
    share = share_of_ratio(log_ratio)
    mass[MINES] += _RELIABILITY * share
    mass[_CLUTTER] += _RELIABILITY * (1.0 - share)
    return mass


def with_ratio(mass: Array, log_ratio: float) -> Array:
    """Combine `mass` (32,) and evidence in nats by Dempster's rule, (32,)."""
    both = conjunctive(mass, mass_of_ratio(log_ratio))[0]
    both[0] = 0.0
    return np.asarray(both / both.sum())
