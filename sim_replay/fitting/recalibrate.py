"""Recalibrate odds and expected background by what people judged: `auv-mcm calibrate odds --verdicts`.

Three numbers change, each drawn to no change by a normal prior. Log-odds L become L + a + c (L - L0), which is Platt's
scaling (J. Platt, "Probabilistic outputs for support vector machines", 1999) about L0, the lowest log-odds reported.
Verdicts that are all against mines pull both a and c below 0, and so raise no p_mine from there on, and none to there.
The logarithm of the background's density changes by b. Offset and slope go into the weights of every step, so that the
chain works as before; the payload moves its background and its gate along.

Each mission is judged by what the others give. Without a gain there that excludes harm nothing is changed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.odds import MineOdds, Recalibration, Tree, Weights
from auv_mcm.contacts.background import BIN_NATS, LOWEST_NATS, N_BINS, BackgroundPrior, known_background
from auv_mcm.contacts.expected_alarms import called_from_nats
from auv_mcm.errors import BadInputError
from sim_replay.fitting.fit_background import log_odds_of
from sim_replay.fitting.judged_missions import MINE, NOT_MINE, JudgedMission
from sim_replay.verdicts import MIN_MINE_LIKE, MIN_MISSIONS, MIN_NOT_MINE_LIKE

Array = NDArray[np.float64]

OFFSET_SD: Final = 0.5  # nats, prior of a: half of what the background's density varies by from mission to mission
SLOPE_SD: Final = 0.1  # prior of c: a change of one nat at p_mine 0.99
BACKGROUND_SD: Final = 0.5  # nats, prior of b, as of a
MOST_VERDICTS: Final = 200
"""Verdicts of a mission that count in full; more share that weight, as errors go together within a mission."""
_CONFIDENCE: Final = 0.95  # of the interval of the gain, as of all intervals in the documents
_CHANCE_SIGMAS: Final = 2.0  # standard deviations of a Poisson count
_SLOPES: Final = (0.5, 2.0)  # the prior keeps far within
_MAX_STEPS: Final = 50  # of Newton's method, which settles in about five
_SETTLED: Final = 1e-12  # nats
_DIGITS: Final = 6  # significant digits that are written


class Change(NamedTuple):
    """Hold what is changed: log-odds become offset_nats + slope * log-odds; see Recalibration."""

    slope: float = 1.0
    offset_nats: float = 0.0
    background_nats: float = 0.0

    def applied(self, log_odds: Array) -> Array:
        """Change log-odds, (n,)."""
        return self.offset_nats + self.slope * log_odds


class Reached(NamedTuple):
    """Count at the operating point.

    called, missed: judged mine-like; missed ones include those without a contact. false_alarms: called and judged not
    mine-like. not_judged: called, and nobody said what they are.
    """

    called: int
    missed: int
    false_alarms: int
    not_judged: int


class MissionLine(NamedTuple):
    """Compare one mission as it was with what the other missions would have made of it.

    gain_nats: log-loss of a verdict less than before, on average.
    """

    mission: JudgedMission
    before: Reached
    after: Reached
    gain_nats: float


class Refit(NamedTuple):
    """Hold a change fitted to all missions, and each mission judged by that of the others.

    gain_nats, low_nats, high_nats: mean over missions, and its 95 % interval by Student's t. refusal: why the change
    must not be used, empty if it may.
    """

    change: Change
    lines: tuple[MissionLine, ...]
    gain_nats: float
    low_nats: float
    high_nats: float
    refusal: str


def refit(missions: Sequence[JudgedMission], prior: BackgroundPrior) -> Refit:
    """Fit a change to judged missions, and judge it by leaving out one after the other.

    prior: of the background, as it ships for the detector. Raises BadInputError for too few missions or verdicts.
    """
    check_evidence(missions)
    lines = []
    for number, mission in enumerate(missions):
        others = fit_change([*missions[:number], *missions[number + 1 :]], prior)
        before, after = (reached(mission, one) for one in (Change(), others))
        lines.append(MissionLine(mission, before, after, log_loss(mission, Change()) - log_loss(mission, others)))
    gains = np.array([line.gain_nats for line in lines if math.isfinite(line.gain_nats)])
    found = Refit(fit_change(missions, prior), tuple(lines), *_interval(gains), "")
    return found._replace(refusal=_refusal(found))


def check_evidence(missions: Sequence[JudgedMission]) -> None:
    """Check that there is enough to learn from. Raises BadInputError saying what is needed."""
    needs = (
        (len([one for one in missions if (one.calls >= 0).any()]), MIN_MISSIONS, "missions with contacts judged"),
        (sum(one.count(MINE) for one in missions), MIN_MINE_LIKE, "contacts judged mine-like"),
        (sum(one.count(NOT_MINE) for one in missions), MIN_NOT_MINE_LIKE, "contacts judged not mine-like"),
    )
    missing = [f"{n} {what}, {least} are needed" for n, least, what in needs if n < least]
    if missing:
        raise BadInputError(f"too little was judged to change the odds: {'; '.join(missing)}. Judge more missions.")


def fit_change(missions: Sequence[JudgedMission], prior: BackgroundPrior) -> Change:
    """Fit offset, slope and background to judged missions; no verdicts give no change."""
    judged = [mission.calls >= 0 for mission in missions]
    log_odds = [one.log_odds[chosen] for one, chosen in zip(missions, judged, strict=True)]
    is_mine = [one.calls[chosen] == MINE for one, chosen in zip(missions, judged, strict=True)]
    weight = [np.full(len(one), min(1.0, MOST_VERDICTS / max(len(one), 1))) for one in log_odds]
    a, c = map_offset_slope(*(np.concatenate([np.empty(0), *part]) for part in (log_odds, is_mine, weight)))
    slope = min(max(_rounded(1.0 + c), _SLOPES[0]), _SLOPES[1])
    change = Change(slope, _rounded(a - (slope - 1.0) * LOWEST_NATS))
    return change._replace(background_nats=_rounded(_background_shift(missions, change, prior)))


def map_offset_slope(log_odds: Array, is_mine: Array, weight: Array) -> tuple[float, float]:
    """Find the most probable a and c for log-odds (n,), shares of a mine (n,) in 0..1, and weights (n,).

    Newton's method with halved steps, on a strictly convex function: log-loss plus half the squares of both, in
    standard deviations of their priors.
    """
    # Below the lowest level the line would turn about L0; what lies there counts as lying at L0.
    base = np.maximum(log_odds, LOWEST_NATS)
    columns = np.column_stack([np.ones(len(base)), base - LOWEST_NATS])
    precision = np.array([OFFSET_SD, SLOPE_SD]) ** -2.0

    def loss(at: Array) -> float:
        odds = base + columns @ at
        return float(weight @ (np.logaddexp(0.0, odds) - is_mine * odds) + 0.5 * precision @ at**2)

    at = np.zeros(2)
    for _ in range(_MAX_STEPS):
        p = _probabilities(base + columns @ at)
        gradient = columns.T @ (weight * (p - is_mine)) + precision * at
        hessian = columns.T @ ((weight * p * (1.0 - p))[:, np.newaxis] * columns) + np.diag(precision)
        step = np.linalg.solve(hessian, gradient)
        share = 1.0
        while share > 1e-6 and loss(at - share * step) > loss(at):
            share *= 0.5
        at = at - share * step
        if float(np.abs(step).max()) < _SETTLED:
            break
    return float(at[0]), float(at[1])


def log_loss(mission: JudgedMission, change: Change) -> float:
    """Compute the mean log-loss of a mission's verdicts, nats; NaN without any."""
    judged = mission.calls >= 0
    if not judged.any():
        return math.nan
    odds = change.applied(mission.log_odds[judged])
    return float((np.logaddexp(0.0, odds) - (mission.calls[judged] == MINE) * odds).mean())


def reached(mission: JudgedMission, change: Change) -> Reached:
    """Count what is called at the mission's operating point after a change."""
    odds = change.applied(mission.log_odds)
    is_called = odds >= called_from_nats(odds, mission.area_km2, mission.asked_per_km2)
    is_mine, is_other = mission.calls == MINE, mission.calls == NOT_MINE
    return Reached(
        called=int(np.count_nonzero(is_mine & is_called)),
        missed=int(np.count_nonzero(is_mine & ~is_called)) + mission.n_missed,
        false_alarms=int(np.count_nonzero(is_other & is_called)),
        not_judged=int(np.count_nonzero(is_called & (mission.calls < 0))),
    )


def recalibrated(odds: MineOdds, found: Refit, made_by: str) -> MineOdds:
    """Change the weights of every step, with a record of what they were changed by."""
    slope, offset_nats, background_nats = found.change
    missions = [line.mission for line in found.lines]
    n_mines, n_others = (sum(mission.count(call) for mission in missions) for call in (MINE, NOT_MINE))

    def changed(weights: Weights) -> Weights:
        return Weights(
            offset=offset_nats + slope * weights.offset,
            weights={name: slope * weight for name, weight in weights.weights.items()},
            trees=tuple(Tree(ask=tree.ask, nats=tuple(slope * nats for nats in tree.nats)) for tree in weights.trees),
        )

    return MineOdds(
        fitted_on=f"{odds.fitted_on}; recalibrated by {n_mines + n_others} verdicts on {len(missions)} missions",
        made_by=f"{odds.made_by}; {made_by}" if odds.made_by else made_by,
        prior=offset_nats + slope * odds.prior,
        detector=changed(odds.detector),
        contours=None if odds.contours is None else changed(odds.contours),
        shape=None if odds.shape is None else changed(odds.shape),
        verifier=None if odds.verifier is None else odds.verifier.recalibrated(slope, offset_nats),
        recalibrated=Recalibration(
            detector=missions[0].detector,
            slope=slope,
            offset_nats=offset_nats,
            background_nats=background_nats,
            missions=tuple(mission.name for mission in missions),
            n_mine_like=n_mines,
            n_not_mine_like=n_others,
            gain_nats=round(found.gain_nats, _DIGITS),
            low_nats=round(found.low_nats, _DIGITS),
            high_nats=round(found.high_nats, _DIGITS),
        ),
    )


def refit_words(found: Refit) -> list[str]:
    """Say what changes, and what it would have done on each mission, in lines."""
    change = found.change
    examples = ", ".join(f"{p:g} becomes {_after(change, p):.3f}" for p in (0.01, 0.2, 0.5, 0.9, 0.99))
    heads = (
        *("mission", "mines", "called before", "after", "missed before", "after", "false alarms/km² before", "after"),
        *("called, not judged, before", "after", "log-loss less by"),
    )
    rows = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for mission, before, after, mission_gain in found.lines:
        cells = (
            *(mission.name.replace("|", "/"), mission.count(MINE), before.called, after.called),
            *(before.missed, after.missed),
            *(f"{one.false_alarms / mission.area_km2:.1f}" for one in (before, after)),
            *(before.not_judged, after.not_judged, f"{mission_gain:+.4f}"),
        )
        rows.append(f"| {' | '.join(map(str, cells))} |")
    gain = f"{found.gain_nats:+.4f} nats ({found.low_nats:+.4f} to {found.high_nats:+.4f})"
    return [
        f"log-odds of a mine: {change.offset_nats:+.3f} + {change.slope:.3f} times what they were; p_mine {examples}",
        f"background of non-mines: {math.exp(change.background_nats):.2f} times as dense as expected before",
        "each mission, at its operating point, by what the other missions give:",
        "",
        *rows,
        "",
        f"log-loss of a verdict on missions left out: less by {gain}",
    ]


def _refusal(found: Refit) -> str:
    before, after = (
        Reached(*(sum(counts) for counts in zip(*parts, strict=True)))
        for parts in zip(*((line.before, line.after) for line in found.lines), strict=True)
    )
    if not found.low_nats > 0.0:
        return (
            f"on missions left out the log-loss of a verdict becomes less by {found.gain_nats:+.4f} nats, with 95 % "
            f"between {found.low_nats:+.4f} and {found.high_nats:+.4f}: that does not exclude harm. The odds stay as "
            "they are; more missions, judged from the first contact to the last, may show more."
        )
    # Calls move by a bin of log-odds either way, so that a few false alarms more may be chance; a mine less is not.
    by_chance = _CHANCE_SIGMAS * math.sqrt(before.false_alarms)
    loses_mines = after.called < before.called and after.false_alarms >= before.false_alarms
    if loses_mines or (after.called <= before.called and after.false_alarms > before.false_alarms + by_chance):
        return (
            f"on missions left out {after.called} objects judged mine-like and {after.false_alarms} others would be "
            f"called, instead of {before.called} and {before.false_alarms}. The odds stay as they are."
        )
    return ""


def _background_shift(missions: Sequence[JudgedMission], change: Change, prior: BackgroundPrior) -> float:
    """Find how much denser the background is than the prior expects, as the logarithm's most probable shift.

    A contact that nobody judged counts by its probability of not being a mine. Missions where nobody judged anything
    against mines say nothing.
    """
    mean, precision = np.array(prior.mean), np.linalg.inv(np.array(prior.covariance))
    pull, weight = 0.0, 1.0 / BACKGROUND_SD**2
    for mission in missions:
        if not mission.count(NOT_MINE):
            continue
        share = np.where(mission.calls == NOT_MINE, 1.0, 1.0 - _probabilities(change.applied(mission.log_odds)))
        share[mission.calls == MINE] = 0.0
        values, _ = known_background(
            _weighed(mission.log_odds, share),
            mission.area_km2,
            prior,
            reported_from_nats=max(mission.reported_from_nats, LOWEST_NATS),
        )
        pull += float(np.sum(precision @ (values - mean)))
        weight += float(precision.sum())
    return float(pull / weight)


def _weighed(log_odds: Array, share: Array) -> Array:
    kept = log_odds >= LOWEST_NATS
    bins = np.minimum(np.floor((log_odds[kept] - LOWEST_NATS) / BIN_NATS), N_BINS - 1).astype(np.int64)
    return np.bincount(bins, share[kept], minlength=N_BINS).astype(np.float64)


def _interval(gains: Array) -> tuple[float, float, float]:
    """Compute the mean of gains and its interval by Student's t; nothing is known of fewer than two."""
    if len(gains) < 2:
        return (float(gains.mean()) if len(gains) else math.nan), -math.inf, math.inf
    from scipy.special import stdtrit

    quantile: Callable[[float, float], float] = stdtrit
    half = float(quantile(len(gains) - 1, 0.5 + 0.5 * _CONFIDENCE)) * float(gains.std(ddof=1)) / math.sqrt(len(gains))
    mean = float(gains.mean())
    return mean, mean - half, mean + half


def _probabilities(odds: Array) -> Array:
    return np.asarray(np.exp(-np.logaddexp(0.0, -odds)))


def _after(change: Change, p_mine: float) -> float:
    return float(_probabilities(change.applied(log_odds_of([p_mine])))[0])


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
