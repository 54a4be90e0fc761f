"""Measure on this computer what each unit of the chain's work costs: the price list of `budget:` in the
configuration."""

from __future__ import annotations

import math
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import msgspec

from auv_mcm.budget import HYPOTHESES_PER_LOOK, MOVES_PER_LOOK, Allowance, look_price_us
from auv_mcm.chain_models import ChainModels, read_models
from auv_mcm.classify.fit import SOLIDS, Effort
from auv_mcm.classify.odds import MineOdds
from auv_mcm.confirmation import (
    Examination,
    ExaminationStep,
    confirm_detection,
    examine,
    is_worth_confirming,
    opinions_on,
    region_of,
)
from auv_mcm.detect.cascade.speed import measure_speed
from auv_mcm.detect.detect_tile import detect_tile, worth_looking
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import Detection, Ping, SourceEvent, Tile
from auv_mcm.settings.budget_settings import BudgetConfig
from auv_mcm.settings.config import Config
from sim_replay.logs.open_log import open_log

if TYPE_CHECKING:
    from sim_replay.simulator.scene import Scene

SCENE: Final = "rough"
"""The named scene that prices are measured on: of all it has most places to measure and to look at."""
_SEED: Final = 600  # of the missions timed
_LEG_M: Final = 120.0  # m of track timed
_MAX_EVENTS: Final = 20_000  # of a log: five minutes of pings and navigation, each at some 30 Hz
_MAX_LOOKS: Final = 60  # confirmations timed
_N_RUNS: Final = 3  # of which the least price counts
_WAY_TO_TILES: Final = ("intake", "law", "waterfall")
_OF_PIXELS: Final = ("seabed", "coverage")
_OF_CONTOURS: Final[tuple[ExaminationStep, ...]] = ("first contours", "second contours")
_DIGITS: Final = 3  # significant, of a price
_N_COLUMNS: Final = 1000  # of the tile that prices are explained by: 60 m of ground range, 0.06 m each
_SIDES: Final = 2  # port and starboard share the time
_US_PER_S: Final = 1e6  # microseconds per second

Clock = Callable[[], float]


class PriceList(NamedTuple):
    """Hold prices, and how many units of work they were measured on."""

    prices: BudgetConfig
    n_units: dict[str, int]


def measure_prices(
    config: Config, clock: Clock = time.thread_time, n_runs: int = _N_RUNS, log: Path | None = None
) -> PriceList:
    """Fly a short mission over rough ground, or play a log, and divide the time of each stage by its work.

    The chain is that of this configuration. What there was no work for keeps its price.

    Parameters
    ----------
    config
        Of the payload.
    clock
        Returns processor time, s.
    n_runs
        Runs of which the least price counts, each by itself: what else runs on a computer only ever adds to processor
        time, by half and more where caches are shared.
    log
        Of the payload's own sonar, whose beginning is played; None for the simulated mission.

    Raises BadInputError for a log that cannot be used.
    """
    mission = partial(_flown, config) if log is None else partial(_played, config, log)
    runs = [_measured_once(*mission(), config.budget, clock) for _ in range(n_runs)]
    prices = [msgspec.structs.asdict(run.prices) for run in runs]
    least = {name: min(each[name] for each in prices) for name in prices[0] if name != "duty"}
    return runs[0]._replace(prices=BudgetConfig(**least))


def _flown(config: Config) -> tuple[Iterable[SourceEvent], Config]:
    """Begin the simulated mission, with the configuration for it."""
    from sim_replay.missions import config_for
    from sim_replay.simulator.mission import Mission
    from sim_replay.simulator.scene_file import read_scene

    scene = _short(read_scene(SCENE))
    sections = {name: getattr(config, name) for name in ("detect", "confirm", "contacts", "waterfall")}
    return Mission(scene).events(), config_for(scene, Config(**sections))


def _played(config: Config, log: Path) -> tuple[Iterable[SourceEvent], Config]:
    return islice(open_log(log, config), _MAX_EVENTS), config


def _measured_once(events: Iterable[SourceEvent], config: Config, known: BudgetConfig, clock: Clock) -> PriceList:
    models, _ = read_models(config)
    model, odds = models.model, models.odds
    tiles: list[Tile] = []
    asked: list[Detection] = []
    looked_at: list[Detection] = []

    def look(detection: Detection) -> Detection:
        done = confirm_detection(detection, config.sonar.beam_width_rad, odds, config.confirm, sizes=models.sizes)
        if detection.surroundings is not None and is_worth_confirming(detection, odds, config.confirm):
            asked.append(detection)
            if done.confirmation is not None:
                looked_at.append(detection)
        return done

    pipeline = Pipeline(config, timer=clock, look=look)
    n_samples = 0
    for event in events:
        if isinstance(event, Ping):
            n_samples += sum(trace.samples.size for trace in (event.port, event.starboard) if trace is not None)
        tiles += [found for found in pipeline.feed(event) if isinstance(found, Tile)]
    tiles += [found for found in pipeline.finish() if isinstance(found, Tile)]
    n_pixels = sum((tile.core_stop - tile.core_start) * tile.mask.shape[1] for tile in tiles)
    speed = (
        math.nan
        if model is None
        else measure_speed(model, config.waterfall.row_spacing_m, config.waterfall.column_spacing_m)
    )
    comparison_s = known.comparison_us / _US_PER_S if model is None else 1.0 / speed
    bare_s, peak_s, n_peaks = _detection_costs(tiles, config, models, comparison_s, clock)
    opinions_s = _opinions_cost_s(asked, config, odds, clock)
    looks_s, n_work = _look_costs(looked_at[:_MAX_LOOKS], config, models, clock)
    costs_s = pipeline.costs_s
    contours_s = sum(looks_s[step] for step in _OF_CONTOURS)
    other_s = sum(looks_s.values()) - contours_s - looks_s["solids"]
    prices = BudgetConfig(
        sample_us=_price_us(sum(costs_s.get(stage, 0.0) for stage in _WAY_TO_TILES), n_samples, known.sample_us),
        pixel_us=_price_us(bare_s + sum(costs_s.get(stage, 0.0) for stage in _OF_PIXELS), n_pixels, known.pixel_us),
        comparison_us=_price_us(comparison_s, 1, known.comparison_us),
        peak_us=_price_us(peak_s, n_peaks, known.peak_us),
        contour_move_us=_price_us(contours_s, n_work["moves"], known.contour_move_us),
        opinion_us=_price_us(opinions_s, len(asked), known.opinion_us),
        field_us=_price_us(other_s, n_work["looks"], known.field_us),
        hypothesis_us=_price_us(looks_s["solids"], n_work["hypotheses"], known.hypothesis_us),
    )
    return PriceList(prices, {"samples": n_samples, "pixels": n_pixels, "peaks": n_peaks, **n_work})


def price_words(prices: BudgetConfig, config: Config, speed_mps: float, duty: float) -> str:
    """Say what a duty buys at a speed over ground, for a tile of _N_COLUMNS columns."""
    grid = config.waterfall
    period_s = grid.tile_rows * grid.row_spacing_m / speed_mps / _SIDES
    bare = Allowance(duty * period_s * _US_PER_S, grid.tile_rows * _N_COLUMNS * prices.pixel_us, prices)
    n_comparisons = bare.comparisons() or 0
    return (
        f"at {speed_mps:g} m/s a tile every {period_s:.1f} s; {duty:.0%} of one core is {bare.total_us / 1e3:.0f} ms "
        "of work on each. "
        f"Of that, for {_N_COLUMNS} columns:\n"
        f"  {bare.cheapest_us / 1e3:.0f} ms for the cheapest pass, and {prices.sample_us:g} us for each stored sample\n"
        f"  {bare.left_us / 1e3:.0f} ms more, in which the cascade could make {n_comparisons / 1e6:.0f} million "
        "comparisons\n"
        f"  or {bare.n_looks(0, 0)} looks of {look_price_us(prices) / 1e3:.1f} ms be made"
    )


def _short(scene: Scene) -> Scene:
    from sim_replay.simulator.scene import Lawnmower

    assert isinstance(scene.track.plan, Lawnmower)
    plan = msgspec.structs.replace(scene.track.plan, n_legs=1, leg_m=_LEG_M)
    return msgspec.structs.replace(scene, seed=_SEED, track=msgspec.structs.replace(scene.track, plan=plan))


def _detection_costs(
    tiles: list[Tile], config: Config, models: ChainModels, comparison_s: float, clock: Clock
) -> tuple[float, float, int]:
    """Time detection without measuring or the cascade, and measuring; s each, with the number of peaks measured."""
    unmeasured = msgspec.structs.replace(
        config, detect=msgspec.structs.replace(config.detect, max_candidates_per_tile=0)
    )
    bare_s, whole_s, n_peaks = 0.0, 0.0, 0
    for tile in filter(worth_looking, tiles):
        began_s = clock()
        bare = detect_tile(tile, unmeasured, models.model, models.gate)
        between_s = clock()
        whole = detect_tile(tile, config, models.model, models.gate)
        bare_s += between_s - began_s - bare.n_evaluations * comparison_s
        whole_s += clock() - between_s - whole.n_evaluations * comparison_s
        n_peaks += len(whole.detections)
    return max(bare_s, 0.0), max(whole_s - bare_s, 0.0), n_peaks


def _opinions_cost_s(detections: list[Detection], config: Config, odds: MineOdds, clock: Clock) -> float:
    """Time the verifier's opinions on detections, all asked together as those of a tile are, s."""
    began_s = clock()
    if odds.verifier is not None:
        opinions_on(detections, config.sonar.beam_width_rad, odds)
    return clock() - began_s


def _look_costs(
    detections: list[Detection], config: Config, models: ChainModels, clock: Clock
) -> tuple[dict[ExaminationStep, float], Counter[str]]:
    """Time the steps of examinations, s, and count their work."""
    spent: dict[ExaminationStep, float] = defaultdict(float)
    work = Counter(looks=0, moves=0, hypotheses=0)
    examined = partial(_examined, config=config, models=models, clock=clock, spent=spent)
    for detection in detections:
        found = examined(detection)
        if found is not None:
            work["looks"] += 1
            work["moves"] += found.contours.n_moves
            work["hypotheses"] += (
                0 if found.fits is None else hypotheses_of(Effort(), sum(fit.refined for fit in found.fits.fits))
            )
    return spent, work


def hypotheses_of(effort: Effort, n_refined: int) -> int:
    """Count the hypotheses that a search for solids weighs, of which n_refined are refined with the beam."""
    each = effort.n_starts + effort.n_walks * effort.n_steps * effort.n_tries
    return len(SOLIDS) * each + n_refined * effort.n_fine_walks * effort.n_fine_steps * effort.n_fine_tries


def _examined(
    detection: Detection, config: Config, models: ChainModels, clock: Clock, spent: dict[ExaminationStep, float]
) -> Examination | None:
    if detection.surroundings is None:
        return None
    mark = clock()

    def done(step: ExaminationStep) -> None:
        nonlocal mark
        now = clock()
        spent[step] += now - mark
        mark = now

    region = region_of(detection, detection.surroundings, config.sonar.beam_width_rad)
    return examine(detection, region, models.odds, config.confirm.min_p_mine, done, ranges=models.sizes.ranges)


def _price_us(cost_s: float, n_units: int, known_us: float) -> float:
    """Price of a unit, to three digits; never nothing, for a clock may be coarse. Without units what is known stays."""
    price_us = known_us if n_units == 0 else max(cost_s, 1e-9) / n_units * _US_PER_S
    return float(f"{price_us:.{_DIGITS}g}")


def look_work(n_work: dict[str, int]) -> str:
    """Say how many moves and hypotheses a look took here, beside the averages that looks are priced with."""
    n_looks = max(n_work.get("looks", 0), 1)
    moves, hypotheses = n_work.get("moves", 0) / n_looks, n_work.get("hypotheses", 0) / n_looks
    return (
        f"a look made {moves:.0f} moves and weighed {hypotheses:.0f} hypotheses (priced: {MOVES_PER_LOOK} and "
        f"{HYPOTHESES_PER_LOOK})"
    )
