"""Fit the tables of performance to the outcomes of looks."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from functools import cache
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import betaincinv, expit, logit

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.clearance.clearance_map import HIGHEST_P
from auv_mcm.clearance.detection_performance import (
    ASPECTS_RAD,
    FLOORS,
    RIPPLES,
    Band,
    CellView,
    Floor,
    Performance,
    aspect_rad,
    more_than_usual_db,
)
from auv_mcm.errors import BadInputError
from auv_mcm.records import SEABED_TYPES
from auv_mcm.settings.config import USUAL_BEAM_DEG
from sim_replay.fitting.detection_performance.closed_form import p_found
from sim_replay.fitting.detection_performance.looks import CellPass

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

EDGES_M: Final = (0.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 75.0)  # m of ground range, of the table's bands
PRIOR_LOOKS: Final = 20.0  # that the closed form counts as
_ALTITUDE_M: Final = 6.5  # m that ranges of other altitudes are scaled to
# of the altitude, tried in turn; the best on left-out missions is taken
_EXPONENTS: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
_MAX_LOSS: Final = 5.0  # of log-odds per dB of unevenness: at most in its search; 0.9 comes
_LIKELY_P: Final = 0.5  # of a look whose correlation with another counts
_ROUNDING: Final = 1e-5  # of a share: bands all of whose looks found, or none, say nothing of scatter
_MAX_LOG_ODDS: Final = 12.0  # of a band all of whose looks found, or none
_TEXTURES: Final = tuple(float(f"{texture:.3g}") for texture in np.geomspace(0.3, 30.0, 21))
_SAME_LOOK_RAD: Final = math.radians(15.0)
_TAIL: Final = 0.025  # probability beyond each end of the central 95 % interval
_MIN_GROUP: Final = 5  # views of a mission and band, for its scatter
_DIGITS: Final = 4  # decimals of a probability in the file


class Outcomes(NamedTuple):
    """Hold looks as columns, (n,) each. floor: index into FLOORS. seabed: into SEABED_TYPES."""

    mission: Ints
    target: Ints
    time_s: Array
    floor: Ints
    seabed: Ints
    ground_range_m: Array
    altitude_m: Array
    look_rad: Array
    ripple_rad: Array
    found: NDArray[np.bool_]
    unevenness_db: Array


class SmoothedBands(NamedTuple):
    """Hold per band: mean, and 95 % interval."""

    p: Array
    low: Array
    high: Array


def outcomes(looks: Sequence[CellPass]) -> Outcomes:
    """Return looks over a fitted floor, as columns."""
    look_rad = np.array([look.look_rad for look in looks], dtype=np.float64)
    ripple_rad = np.array([np.nan if look.ripple_rad is None else look.ripple_rad for look in looks], dtype=np.float64)
    seabed = np.array([look.seabed for look in looks], dtype=np.int64)
    return Outcomes(
        mission=np.array([look.mission for look in looks], dtype=np.int64),
        target=np.array([look.target for look in looks], dtype=np.int64),
        time_s=np.array([look.time_s for look in looks], dtype=np.float64),
        floor=floors_of(seabed, look_rad, ripple_rad),
        seabed=seabed,
        ground_range_m=np.array([look.ground_range_m for look in looks], dtype=np.float64),
        altitude_m=np.array([look.altitude_m for look in looks], dtype=np.float64),
        look_rad=look_rad,
        ripple_rad=ripple_rad,
        found=np.array([look.p_mine >= MINE_LIKE_P for look in looks], dtype=np.bool_),
        unevenness_db=np.array([look.unevenness_db for look in looks], dtype=np.float64),
    )


def floors_of(seabed: Ints, look_rad: Array, ripple_rad: Array) -> Ints:
    """Return (n,) index into FLOORS; ripples by the nearest middle of aspects."""
    table = np.array([FLOORS.index(name) if name in FLOORS else RIPPLES.start for name in SEABED_TYPES], dtype=np.int64)
    aspect = np.nan_to_num(aspect_rad(look_rad, ripple_rad))
    nearest = np.argmin(np.abs(aspect[:, np.newaxis] - np.array(ASPECTS_RAD)), axis=1)
    return np.where(seabed == SEABED_TYPES.index("ripple"), RIPPLES.start + nearest, table[seabed])


def fit_performance(looks: Sequence[CellPass], fitted_on: str, beam_width_deg: float = USUAL_BEAM_DEG) -> Performance:
    """Fit the tables, with the altitude's exponent that best predicts left-out missions, and what unevenness costs.

    beam_width_deg: the widest beam that they hold for.

    Raises BadInputError if a floor was never looked at, or there are fewer than two missions.
    """
    seen = outcomes(looks)
    if missing := [name for index, name in enumerate(FLOORS) if not (seen.floor == index).any()]:
        raise BadInputError(f"{fitted_on}: no look at {', '.join(missing)}. Fly more missions, with --seeds")
    if len(np.unique(seen.mission)) < 2:
        raise BadInputError(f"{fitted_on}: one mission does not show how missions differ. Fly more, with --seeds")
    loss_per_db = likeliest_loss(seen, _EXPONENTS[len(_EXPONENTS) // 2])
    exponent = min(_EXPONENTS, key=lambda candidate: surprise_left_out(seen, candidate, loss_per_db))
    tables = fitted_tables(seen, exponent, fitted_on, likeliest_loss(seen, exponent))
    return with_correlations(msgspec.structs.replace(tables, beam_width_deg=beam_width_deg), seen)


def likeliest_loss(seen: Outcomes, exponent: float) -> float:
    """Find the loss of log-odds per dB of unevenness that, with the tables fitted for it, makes outcomes likeliest."""

    def surprise_by(loss_per_db: float) -> float:
        return surprise(fitted_tables(seen, exponent, "", loss_per_db), seen)

    return round(float(minimize_scalar(surprise_by, bounds=(0.0, _MAX_LOSS), method="bounded").x), _DIGITS)


def fitted_tables(seen: Outcomes, exponent: float, fitted_on: str, loss_per_db: float = 0.0) -> Performance:
    """Fit the tables for one exponent and one loss by unevenness, looks taken for independent."""
    band = bands_of(seen, exponent)
    n_looks, n_found = (counts(seen.floor, band, weight) for weight in (None, seen.found))
    more_log_odds = -loss_per_db * more_than_usual_db(seen.unevenness_db)
    usual = shares_where_usual(seen, band, more_log_odds)
    effect = design_effect(seen, band, more_log_odds)
    floors: dict[Floor, tuple[Band, ...]] = {}
    for index, name in enumerate(FLOORS):
        n_as_usual = usual[index] * n_looks[index]
        prior = closed_form_prior(n_looks[index], n_as_usual)
        smooth = smooth_bands(n_as_usual, n_looks[index], prior, effect)
        floors[name] = tuple(
            Band(
                n_looks=int(n),
                n_found=int(k),
                p=round(float(p), _DIGITS),
                low=round(float(low), _DIGITS),
                high=round(float(high), _DIGITS),
            )
            for n, k, p, low, high in zip(n_looks[index], n_found[index], *smooth, strict=True)
        )
    return Performance(
        fitted_on=fitted_on,
        altitude_m=_ALTITUDE_M,
        altitude_exponent=exponent,
        edges_m=EDGES_M,
        floors=floors,
        same_look_correlation=0.0,
        other_look_correlation=0.0,
        loss_per_db=loss_per_db,
    )


def shares_where_usual(seen: Outcomes, band: Ints, more_log_odds: Array) -> Array:
    """Find the share of looks that would have found their target had no floor been more uneven than usual.

    (len(FLOORS), n_bands): with it, as many are expected to be found as were; 0 without looks. more_log_odds: (n,) of a
    look than there.
    """
    n_bands = len(EDGES_M) - 1
    n_cells = len(FLOORS) * n_bands
    of_cell = seen.floor * n_bands + band
    n_found = np.bincount(of_cell, seen.found, n_cells)
    low, high = np.full(n_cells, -_MAX_LOG_ODDS), np.full(n_cells, _MAX_LOG_ODDS)
    for _ in range(50):  # bisection, to rounding
        middle = 0.5 * (low + high)
        too_few = np.bincount(of_cell, expit(middle[of_cell] + more_log_odds), n_cells) < n_found
        low, high = np.where(too_few, middle, low), np.where(too_few, high, middle)
    share = np.where(np.bincount(of_cell, minlength=n_cells) > 0, expit(0.5 * (low + high)), 0.0)
    return np.asarray(share.reshape(len(FLOORS), n_bands))


def bands_of(seen: Outcomes, exponent: float) -> Ints:
    """Return (n,) band of each look; ranges beyond the last band count there."""
    range_m = seen.ground_range_m * (_ALTITUDE_M / seen.altitude_m) ** exponent
    return np.clip(np.searchsorted(EDGES_M, range_m, side="right") - 1, 0, len(EDGES_M) - 2)


def counts(floor: Ints, band: Ints, weight: NDArray[np.bool_] | None = None) -> Array:
    """Return (len(FLOORS), n_bands) looks, or those of them that `weight` counts."""
    n_bands = len(EDGES_M) - 1
    flat = np.bincount(floor * n_bands + band, weight, minlength=len(FLOORS) * n_bands)
    return np.asarray(flat.reshape(len(FLOORS), n_bands), dtype=np.float64)


def design_effect(seen: Outcomes, band: Ints, more_log_odds: Array | float = 0.0) -> float:
    """Return how many looks of one mission at one floor and band count as one, at least 1.

    Missions differ in water, sonar and floor, so that shares found vary more from one to the next than counts alone
    would: the mean of Pearson's residuals (P. McCullagh and J. Nelder, "Generalized Linear Models", 1989, Sec. 4.5).

    more_log_odds: (n,) of looks, by their unevenness.
    """
    n_bands = len(EDGES_M) - 1
    of_cell = seen.floor * n_bands + band
    n_cells = len(FLOORS) * n_bands
    usual = shares_where_usual(seen, band, np.broadcast_to(more_log_odds, of_cell.shape)).ravel()
    p = expit(logit(np.clip(usual, _ROUNDING, 1.0 - _ROUNDING))[of_cell] + more_log_odds)
    _, group = np.unique(seen.mission * n_cells + of_cell, return_inverse=True)
    n, k, expected, variance = (np.bincount(group, value) for value in (None, seen.found, p, p * (1.0 - p)))
    cells = np.zeros(len(n), dtype=np.int64)
    cells[group] = of_cell
    used = (n >= _MIN_GROUP) & (usual[cells] > _ROUNDING) & (usual[cells] < 1.0 - _ROUNDING)
    freedom = int(np.count_nonzero(used)) - len(np.unique(cells[used]))
    if freedom < 1:
        return 1.0
    return max(1.0, float(((k - expected)[used] ** 2 / variance[used]).sum() / freedom))


def closed_form_prior(n_looks: Array, n_found: Array) -> Array:
    """Return (n_bands,) probabilities by the closed form with the most likely texture."""
    candidates = _closed_forms()
    p = np.clip(candidates, 1e-3, 1.0 - 1e-3)
    log_likelihood = (n_found * np.log(p) + (n_looks - n_found) * np.log1p(-p)).sum(axis=1)
    return np.asarray(candidates[int(np.argmax(log_likelihood))])


@cache
def _closed_forms() -> Array:
    """Return (n_textures, n_bands) probabilities."""
    middle_m = 0.5 * (np.array(EDGES_M[1:]) + np.array(EDGES_M[:-1]))
    return np.stack([p_found(middle_m, _ALTITUDE_M, texture) for texture in _TEXTURES])


def smooth_bands(n_found: Array, n_looks: Array, prior: Array, effect: float = 1.0) -> SmoothedBands:
    """Smooth shares over bands.

    Posterior means of beta distributions, bands (n,) that would make a second hump pooled: what is found rises with
    range while shadows grow, and falls as echoes fade.

    The interval is that of the pooled beta distribution, no narrower than Jeffreys' (half a look found and half one
    not).
    """
    found = n_found / effect + PRIOR_LOOKS * prior
    looks = n_looks / effect + PRIOR_LOOKS
    block = one_hump(found / looks, looks)
    k, n = np.bincount(block, found)[block], np.bincount(block, looks)[block]
    p = k / n
    a, b = np.maximum(k, 0.5), np.maximum(n - k, 0.5)
    return SmoothedBands(p, np.minimum(betaincinv(a, b, _TAIL), p), np.maximum(betaincinv(a, b, 1.0 - _TAIL), p))


def one_hump(value: Array, weight: Array) -> Ints:
    """Pool bands to one hump.

    (n,) number of the block that each value belongs to, such that block means rise up to one of them and fall from
    there on, with the minimum weighted squares (isotonic regression either side of the best mode).
    """
    best: tuple[float, Ints] | None = None
    for mode in range(len(value) + 1):
        up = rising(value[:mode], weight[:mode])
        down = rising(value[mode:][::-1], weight[mode:][::-1])[::-1]
        block = np.concatenate([up, down.max(initial=0) - down + up.max(initial=-1) + 1])
        mean = np.bincount(block, value * weight)[block] / np.bincount(block, weight)[block]
        loss = float((weight * (value - mean) ** 2).sum())
        if best is None or loss < best[0] - 1e-12:
            best = loss, block
    assert best is not None
    return best[1]


def rising(value: Array, weight: Array) -> Ints:
    """Pool values until they rise.

    (n,) number of each value's block in the isotonic regression, by pooling adjacent violators (M. Ayer et al., Annals
    of Mathematical Statistics 26, 1955).
    """
    blocks: list[tuple[float, float, int]] = []  # mean, weight, length
    for v, w in zip(value.tolist(), weight.tolist(), strict=True):
        blocks.append((v, w, 1))
        while len(blocks) > 1 and blocks[-2][0] >= blocks[-1][0]:
            (v1, w1, n1), (v2, w2, n2) = blocks[-2:]
            blocks[-2:] = [((v1 * w1 + v2 * w2) / (w1 + w2), w1 + w2, n1 + n2)]
    return np.repeat(np.arange(len(blocks)), [length for *_, length in blocks])


def surprise_left_out(seen: Outcomes, exponent: float, loss_per_db: float = 0.0) -> float:
    """Return mean -ln of the outcomes' probability, each mission judged with the tables of the others."""
    total = 0.0
    for mission in np.unique(seen.mission):
        out = seen.mission == mission
        others, own = (Outcomes(*(column[chosen] for column in seen)) for chosen in (~out, out))
        total += surprise(fitted_tables(others, exponent, "", loss_per_db), own)
    return total / len(seen.found)


def surprise(performance: Performance, seen: Outcomes) -> float:
    """Sum -ln of the outcomes' probability by tables."""
    p = np.clip(predicted(performance, seen), 1e-3, 1.0 - 1e-3)
    return -float(np.where(seen.found, np.log(p), np.log1p(-p)).sum())


def predicted(performance: Performance, seen: Outcomes) -> Array:
    """Return (n,) probability of each look, with its true floor."""
    return performance.p_look(CellView(*(getattr(seen, name) for name in CellView._fields)))


def with_correlations(performance: Performance, seen: Outcomes) -> Performance:
    """Add to the tables the effect of a further look, from pairs of looks at one target.

    Of each pair both find more often than not by the tables: where most looks are in vain, an error of the tables would
    pass for correlation. A look in the same direction is taken to add no more than one in another, whatever few pairs
    suggest.
    """
    p = np.minimum(predicted(performance, seen), HIGHEST_P)
    likely = [
        (first[both], second[both])
        for first, second in pairs(seen)
        for both in [np.minimum(p[first], p[second]) >= _LIKELY_P]
    ]
    same, other = (
        round(correlation(p[first], p[second], ~seen.found[first] & ~seen.found[second]), 3) for first, second in likely
    )
    return msgspec.structs.replace(performance, same_look_correlation=max(same, other), other_look_correlation=other)


def pairs(seen: Outcomes) -> tuple[tuple[Ints, Ints], tuple[Ints, Ints]]:
    """Return indices of earlier and later looks at one target.

    From within 15 degrees of each other, and from elsewhere.
    """
    of_target: dict[tuple[int, int], list[int]] = defaultdict(list)
    for index in np.argsort(seen.time_s, kind="stable").tolist():
        of_target[int(seen.mission[index]), int(seen.target[index])].append(index)
    both = np.array(
        [(first, second) for looks in of_target.values() for k, second in enumerate(looks) for first in looks[:k]],
        dtype=np.int64,
    ).reshape(-1, 2)
    apart = np.abs(np.mod(seen.look_rad[both[:, 0]] - seen.look_rad[both[:, 1]] + math.pi, 2.0 * math.pi) - math.pi)
    same = apart <= _SAME_LOOK_RAD
    return (both[same, 0], both[same, 1]), (both[~same, 0], both[~same, 1])


def correlation(p_first: Array, p_second: Array, missed: NDArray[np.bool_]) -> float:
    """Return rho for which targets are missed twice as often as observed.

    The mean over pairs (n,) of (1 - p_first) (1 - p_second)^(1 - rho) is then the share of `missed`. 0 or 1 where no
    rho does that, 0 without pairs.
    """
    if not len(missed):
        return 0.0
    share = float(missed.mean())
    low, high = 0.0, 1.0
    for _ in range(50):
        rho = 0.5 * (low + high)
        if float(((1.0 - p_first) * (1.0 - p_second) ** (1.0 - rho)).mean()) < share:
            low = rho
        else:
            high = rho
    return 0.5 * (low + high)
