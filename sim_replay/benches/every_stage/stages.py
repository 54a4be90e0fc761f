"""Measure every stage's time against its error, and that of what a user would take instead."""

from __future__ import annotations

import contextlib
import io
import itertools
import math
import statistics
from collections.abc import Callable, Hashable
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Final

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from auv_mcm.classify.fit import Effort, fit_shapes
from auv_mcm.classify.likelihood import image_row_sums
from auv_mcm.confirm.mrf import edge_weights
from auv_mcm.confirm.region import HIGHLIGHT, SHADOW, Region
from auv_mcm.confirm.snake import Start, converge
from auv_mcm.confirm.snake_rules import contour_mask
from auv_mcm.confirm.speckle import Correlation
from auv_mcm.kernels.shape import Solid, intervals_numpy, single_solid
from auv_mcm.kernels.trws import energy_of, icm, trws
from auv_mcm.plan.survey import replan
from auv_mcm.waterfall.bottom import BottomTracker
from auv_mcm.waterfall.ground import make_traces, mean_between
from drivers.framing import Framer
from drivers.sonar.ping_protocol import PingGrammar
from sim_replay.augment.direct import invert
from sim_replay.augment.forward import BeamPattern, SeafloorScene, render_image
from sim_replay.benches import cascade, framers, simulate, tours
from sim_replay.benches.every_stage.expansion import expanded
from sim_replay.benches.every_stage.log_reading import log_rows
from sim_replay.benches.every_stage.rows import Alternative, Amount, Cost, StageRow, timed
from sim_replay.benches.every_stage.sea_floor import sea_floor_rows
from sim_replay.scoring.overlap import overlap

Plane = NDArray[np.float64]

_COLUMN_M: Final = 0.06  # of drawn regions, across the track
_ROW_M: Final = 0.12  # and along it
_LEVELS: Final = np.array([1.0, 10.0**-0.9, 8.0])  # of floor, shadow at -9 dB, and highlight
_INDEPENDENT: Final = edge_weights(1.0, (1, 1), Correlation(1.0, 1.0))
_FLOW_S: Final = "scipy maximum flow, alpha expansion"


def _random(*seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(list(seed)))


def resampling_rows(amount: Amount) -> list[StageRow]:
    """Resample pings to ground range: against sums of extended precision; instead, points of np.interp."""
    n_samples, spacing_m = 2000, 0.025
    edges_m = np.hypot(0.12 * np.arange(401), 6.0)
    intensity = _random(1).exponential(size=(32, n_samples)).astype(np.float32)
    yes, no = np.ones(intensity.shape, dtype=np.bool_), np.zeros(intensity.shape, dtype=np.bool_)
    centre_m = (np.arange(n_samples) + 0.5) * spacing_m

    def ours() -> Plane:
        return mean_between(make_traces(intensity, yes, no, 0.5 * spacing_m, spacing_m), edges_m[np.newaxis]).intensity

    def points() -> Plane:
        return np.array([np.interp(0.5 * (edges_m[1:] + edges_m[:-1]), centre_m, ping) for ping in intensity])

    sums = np.concatenate([np.zeros((32, 1)), np.cumsum(intensity, axis=1, dtype=np.longdouble)], axis=1)
    place = np.clip(edges_m / spacing_m, 0.0, n_samples)
    whole = np.minimum(place.astype(np.intp), n_samples - 1)
    reached = sums[:, whole] + (place - whole) * (sums[:, whole + 1] - sums[:, whole])
    truth = np.diff(reached, axis=1) / np.diff(place)
    (mean, cost), (point, other) = timed(amount.repeat, ours, points)

    def error(found: Plane) -> float:
        return float(np.sqrt(np.mean(np.square(np.asarray(found / truth - 1.0, dtype=np.float64)))))

    return [
        StageRow(
            stage="waterfall",
            setting="32 pings of 2000 samples to 400 columns",
            cost=cost,
            error=error(mean),
            unit="root mean square over the true mean",
            limit=1e-9,
            alternative=Alternative(name="numpy interp", cost=other, error=error(point)),
        )
    ]


def bottom_rows(amount: Amount) -> list[StageRow]:
    """Track the bottom under faint water; instead, take the first half metre above three times the water column."""
    rows = []
    for floor_db in (20.0, 8.0):
        n_pings, n_samples, spacing_m = 64, 500, 0.04
        random = _random(2)
        altitude_m = 6.0 + np.sin(np.arange(n_pings) / 20.0)
        slant_m = (np.arange(n_samples) + 0.5) * spacing_m
        mean = np.where(slant_m < altitude_m[:, np.newaxis], 1.0, 10.0 ** (0.1 * floor_db) * (6.0 / slant_m) ** 2)
        intensity = (mean * random.exponential(size=mean.shape)).astype(np.float32)
        yes, no = np.ones(mean.shape, dtype=np.bool_), np.zeros(mean.shape, dtype=np.bool_)

        def ours(intensity: NDArray[np.float32] = intensity, yes: Any = yes, no: Any = no) -> Plane:
            tracker = BottomTracker(1.0)
            traces = make_traces(intensity, yes, no, 0.02, 0.04)
            tracker.add([traces, None], np.full(len(intensity), math.nan), 20.0)
            found = tracker.flush()
            assert found is not None
            return found.first_return_m

        def first(intensity: NDArray[np.float32] = intensity, slant_m: Any = slant_m) -> Plane:
            smooth = ndimage.uniform_filter1d(intensity, 12, axis=1)  # over half a metre
            water = smooth[:, 25:75].mean()  # 1 to 3 m
            return np.asarray(slant_m[25 + (smooth[:, 25:] > 3.0 * water).argmax(axis=1)])

        (tracked, cost), (crossed, other) = timed(amount.repeat, ours, first)
        rows.append(
            StageRow(
                stage="bottom tracking",
                setting=f"{n_pings} pings, floor {floor_db:g} dB over the water",
                cost=cost,
                error=float(np.quantile(np.abs(tracked - altitude_m), 0.95)),
                unit="m, 95 % quantile",
                limit=0.3,
                alternative=Alternative(
                    name="first half metre over 3 times the water",
                    cost=other,
                    error=float(np.quantile(np.abs(crossed - altitude_m), 0.95)),
                ),
            )
        )
    return rows


def cascade_rows(amount: Amount) -> list[StageRow]:
    """Run one cascade here and in OpenCV, over the same windows; times are per million windows visited."""
    cv2.setNumThreads(1)
    model = cascade.drawn_model("stages")
    shape = (192, cascade.SHAPE[1]) if amount.n < 4 else cascade.SHAPE
    rows = []
    for name, image in cascade.drawn_tiles(shape).items():
        found = cascade.against_opencv(model, image, amount.repeat)
        rows.append(
            StageRow(
                stage="cascade",
                setting=f"{name} tile, a million windows",
                cost=Cost((1e3 / found.ours,)),
                error=float(found.n_different),
                unit="windows decided otherwise",
                limit=0.0,
                alternative=Alternative(
                    name=f"cv2.CascadeClassifier, of {found.n_visited} windows it visits",
                    cost=Cost((1e3 / found.opencv,)),
                    error=0.0,
                ),
            )
        )
    return rows


def _drawn_field(seed: int) -> tuple[Plane, NDArray[np.uint8]]:
    """Draw single-look speckle about a highlight and a shadow, (48, 72), and its true labels."""
    random = _random(3, seed)
    labels = np.zeros((48, 72), dtype=np.uint8)
    top, near = int(random.integers(12, 20)), int(random.integers(12, 20))
    rows, columns = np.indices(labels.shape)
    labels[(np.abs(rows - top - 8) < 8) & (columns >= near) & (columns < near + 6)] = HIGHLIGHT
    inside = ((rows - top - 8) / 8.0) ** 2 + ((columns - near - 6) / 28.0) ** 2 < 1.0
    labels[inside & (columns >= near + 6)] = SHADOW
    return _LEVELS[labels] * random.exponential(size=labels.shape), labels


def field_rows(amount: Amount) -> list[StageRow]:
    """Label drawn regions by tree-reweighted messages; instead, iterated conditional modes and alpha expansion."""
    drawn = [_drawn_field(seed) for seed in range(amount.n)]
    costs = [np.asarray(np.log(_LEVELS) + plane[:, :, np.newaxis] / _LEVELS) for plane, _ in drawn]
    bounds = [trws(cost, _INDEPENDENT, 300).lower_bound for cost in costs]

    def by_icm() -> list[NDArray[np.uint8]]:
        return [icm(cost, _INDEPENDENT, cost.argmin(axis=2).astype(np.uint8), 20)[0] for cost in costs]

    def by_flow() -> list[NDArray[np.uint8]]:
        return [expanded(cost, _INDEPENDENT) for cost in costs]

    def gap(found: list[NDArray[np.uint8]]) -> float:
        return statistics.median(
            100.0 * (energy_of(labels, cost, _INDEPENDENT) - bound) / abs(bound)
            for labels, cost, bound in zip(found, costs, bounds, strict=True)
        )

    def missed(found: list[NDArray[np.uint8]]) -> float:
        return 1.0 - statistics.median(
            overlap(labels == SHADOW, truth == SHADOW) for labels, (_, truth) in zip(found, drawn, strict=True)
        )

    sweeps = (1, 3, 10, 50)
    works: list[Callable[[], list[NDArray[np.uint8]]]] = [
        lambda n=n: [trws(cost, _INDEPENDENT, n).labels for cost in costs]  # type: ignore[misc]  # a default is its type
        for n in sweeps
    ]
    done = timed(amount.repeat, *works, by_icm, by_flow)
    rows = []
    for n, (labels, cost) in zip(sweeps, done, strict=False):
        (icm_labels, icm_cost), (flow_labels, flow_cost) = done[-2:]
        for name, other, other_cost in (("ICM", icm_labels, icm_cost), (_FLOW_S, flow_labels, flow_cost)):
            rows.append(
                StageRow(
                    stage="field",
                    setting=f"{n} sweeps, {amount.n} regions",
                    cost=cost,
                    error=gap(labels),
                    unit="% above the bound",
                    limit=0.2 if n >= 10 else None,
                    alternative=Alternative(name=name, cost=other_cost, error=gap(other)),
                )
            )
        rows.append(
            StageRow(
                stage="field",
                setting=f"{n} sweeps, {amount.n} regions",
                cost=cost,
                error=missed(labels),
                unit="1 - IoU of the shadow",
                limit=0.4 if n >= 10 else None,
                alternative=Alternative(name=_FLOW_S, cost=flow_cost, error=missed(flow_labels)),
            )
        )
    return rows


def _region_of(plane: Plane) -> Region:
    return Region(
        intensity=plane,
        valid=np.ones(plane.shape, dtype=np.bool_),
        altitude_m=6.0,
        row_spacing_m=_ROW_M,
        column_spacing_m=_COLUMN_M,
        first_ground_range_m=16.0,
        row=0.5 * plane.shape[0],
        column=20.0,
        beam_width_rad=0.0,
    )


def contour_rows(amount: Amount) -> list[StageRow]:
    """Draw contours of shadows with more and more nodes; instead, two methods of scikit-image."""
    drawn = [_drawn_field(seed) for seed in range(amount.n)]
    box = [np.array([[14.0, a], [14.0, b], [34.0, b], [34.0, a]]) for a, b in ((14.0, 22.0), (22.0, 46.0))]
    start = Start(*box)
    shape = drawn[0][1].shape

    def by_snake(nodes: int) -> list[NDArray[np.bool_]]:
        schedule = ((nodes, 1.0, 30),)
        return [
            contour_mask(converge(_region_of(plane), start, coarse=((4, 2.0, 20),), fine=schedule).shadow, shape)
            for plane, _ in drawn
        ]

    def missed(found: list[NDArray[np.bool_]]) -> float:
        return 1.0 - statistics.median(
            overlap(mask, truth == SHADOW) for mask, (_, truth) in zip(found, drawn, strict=True)
        )

    def by_chan_vese() -> list[NDArray[np.bool_]]:
        segmentation = import_module("skimage.segmentation")
        inside = np.zeros(shape, dtype=np.bool_)
        inside[14:34, 22:46] = True
        found = []
        for plane, _ in drawn:
            image = np.log(np.maximum(ndimage.uniform_filter(plane, 3), 1e-3))
            mask = segmentation.morphological_chan_vese(image, 60, init_level_set=inside, smoothing=2).astype(bool)
            dark = image[mask].mean() < image[~mask].mean() if mask.any() and not mask.all() else True
            found.append(mask if dark else ~mask)
        return found

    def by_active_contour() -> list[NDArray[np.bool_]]:
        segmentation, draw = import_module("skimage.segmentation"), import_module("skimage.draw")
        angle = np.linspace(0.0, 2.0 * np.pi, 40)
        begun = np.column_stack([24.0 + 12.0 * np.sin(angle), 34.0 + 14.0 * np.cos(angle)])
        return [
            draw.polygon2mask(
                shape, segmentation.active_contour(ndimage.gaussian_filter(np.log(np.maximum(p, 1e-3)), 2.0), begun)
            )
            for p, _ in drawn
        ]

    has_skimage = find_spec("skimage") is not None
    nodes = (4, 8, 16)
    works: list[Callable[[], list[NDArray[np.bool_]]]] = [lambda n=n: by_snake(n) for n in nodes]  # type: ignore[misc]  # a default is its type
    others = {"scikit-image Chan-Vese": by_chan_vese, "scikit-image active contour": by_active_contour}
    done = timed(amount.repeat, *works, *(others.values() if has_skimage else ()))
    rows = []
    for k, n in enumerate(nodes):
        for j, name in enumerate(others):
            mask, cost = done[k]
            other = Alternative(name=name, missing="scikit-image is not installed")
            if has_skimage:
                their_mask, their_cost = done[len(nodes) + j]
                other = Alternative(name=name, cost=their_cost, error=missed(their_mask))
            rows.append(
                StageRow(
                    stage="contours",
                    setting=f"{n} nodes, {amount.n} regions",
                    cost=cost,
                    error=missed(mask),
                    unit="1 - IoU of the shadow",
                    limit=0.4 if n == nodes[-1] else None,
                    alternative=other,
                )
            )
    return rows


_SIZES: Final[dict[Solid, tuple[float, ...]]] = {
    "sphere": (0.5, 0.1, 0.0, 0.0, 0.0),
    "cylinder": (0.25, 1.8, 0.9, 0.05, 0.0),
    "truncated_cone": (0.49, 0.25, 0.47, 0.0, 0.0),
    "wedge": (1.0, 0.8, 0.4, 0.6, 0.0),
}
"""Fields of usual mines of each class, m and rad."""
_AT_M: Final = (3.66, 20.0)  # place of drawn objects along and across the track


def _ends(solid: Solid, sizes: tuple[float, ...], region: Region) -> Plane:
    """Find where highlight and shadow of each row begin and the shadow ends, (n_rows, 3) columns, NaN outside."""
    image = image_row_sums(region, 1.0)
    assert image is not None
    return intervals_numpy(solid, np.array([[*_AT_M, 1.0, *sizes]]), image)[0, :, 0]


def _masks(ends: Plane, n_columns: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    column = np.arange(n_columns) + 0.5
    begun = [column >= np.nan_to_num(ends[:, k], nan=math.inf)[:, np.newaxis] for k in range(3)]
    return begun[0] & ~begun[1], begun[1] & ~begun[2]


def solid_rows(amount: Amount) -> list[StageRow]:
    """Fit solids with fewer and more hypotheses to objects drawn by their closed forms; instead, match templates."""
    blank = _region_of(np.ones((61, 170)))
    drawn: list[tuple[Solid, float, Region]] = []
    for (solid, sizes), number in itertools.product(_SIZES.items(), range(amount.n)):
        random = _random(7, number)
        scale = random.uniform(0.85, 1.15)
        own = (*(size * scale for size in sizes[:2]), *sizes[2:])
        highlight, shadow = _masks(_ends(solid, own, blank), 170)
        level = np.where(highlight, 8.0, np.where(shadow, 0.1, 1.0))
        region = msgspec.structs.replace(
            blank, intensity=level * random.exponential(size=level.shape), row=30.5, column=66.0
        )
        drawn.append((solid, _longest_m(single_solid(solid, np.array(own))), region))
    templates: list[tuple[Solid, float, NDArray[np.float32]]] = []
    for solid, sizes in _SIZES.items():
        for scale in (0.85, 1.0, 1.15):
            scaled = (*(size * scale for size in sizes[:2]), *sizes[2:])
            highlight, shadow = _masks(_ends(solid, scaled, blank), 170)
            template = (highlight.astype(np.float32) - shadow)[12:49, 45:125]
            templates.append((solid, _longest_m(single_solid(solid, np.array(scaled))), template - template.mean()))

    def by_fit(effort: Effort) -> list[tuple[Solid, float]]:
        bests = [fit_shapes(region, None, 1.0, effort=effort).fits[0] for _, _, region in drawn]
        return [(best.solid, _longest_m(best.best.shape)) for best in bests]

    def by_template() -> list[tuple[Solid, float]]:
        found = []
        for _, _, region in drawn:
            image = np.log(np.maximum(region.intensity, 1e-2)).astype(np.float32)
            scores = [float(cv2.matchTemplate(image, t, cv2.TM_CCOEFF_NORMED).max()) for *_, t in templates]
            solid, size_m, _ = templates[int(np.argmax(scores))]
            found.append((solid, size_m))
        return found

    efforts = {"160 hypotheses": Effort(160, 4, 10, 6, 2, 10, 6), "default": Effort()}
    works: list[Callable[[], list[tuple[Solid, float]]]] = [
        lambda effort=effort: by_fit(effort)  # type: ignore[misc]  # a default is its type
        for effort in efforts.values()
    ]
    done = timed(amount.repeat, *works, by_template)
    rows = []
    for name, (fits, cost) in zip(efforts, done, strict=False):
        matched, other = done[-1]
        for unit, error, limit in (
            ("share of classes wrong", _wrong, 0.5),
            ("m, median of the longest size", _size_m, 0.3),
        ):
            rows.append(
                StageRow(
                    stage="solids",
                    setting=f"{name}, {len(drawn)} objects",
                    cost=cost,
                    error=error(fits, drawn),
                    unit=unit,
                    limit=limit,
                    alternative=Alternative(
                        name="template match, after Myers and Fawcett", cost=other, error=error(matched, drawn)
                    ),
                )
            )
    return rows


def _longest_m(shape: Any) -> float:
    """Take the longest horizontal extent of a solid."""
    fields = msgspec.structs.asdict(shape)
    widths_m = [2.0 * fields.get(name, 0.0) for name in ("radius_m", "base_radius_m")]
    return float(max(*widths_m, fields.get("length_m", 0.0), fields.get("width_m", 0.0)))


def _wrong(found: list[tuple[Solid, float]], drawn: list[tuple[Solid, float, Region]]) -> float:
    return sum(solid != true for (solid, _), (true, *_) in zip(found, drawn, strict=True)) / len(drawn)


def _size_m(found: list[tuple[Solid, float]], drawn: list[tuple[Solid, float, Region]]) -> float:
    return statistics.median(abs(size - true) for (_, size), (_, true, _) in zip(found, drawn, strict=True))


def simulator_rows(amount: Amount) -> list[StageRow]:
    """Cast shadows on cells of several sizes; the reference is the closed form."""
    rows = []
    for cell_m in (0.1,) if amount.n < 4 else (0.2, 0.1, 0.05):
        ((errors, cost),) = timed(amount.repeat, lambda cell_m=cell_m: simulate.shadow_errors_m(cell_m))  # type: ignore[misc]  # a default is its type
        rows.append(
            StageRow(
                stage="simulator",
                setting=f"cells of {100 * cell_m:g} cm, shadows of 205 objects",
                cost=cost,
                error=float(np.quantile(np.abs(errors), 0.95)),
                unit="m, 95 % quantile of shadows' ends",
                limit=1.1 * cell_m,
            )
        )
    return rows


def inversion_rows(amount: Amount) -> list[StageRow]:
    """Recover relief from an image; instead, add brightness up along each ping."""
    shape, column_m = (128, 256), 0.1
    relief = 3.75 * ndimage.gaussian_filter(_random(9).normal(size=shape), (6, 8), mode="wrap")
    along_m = 0.2 * np.arange(shape[0], dtype=np.float64)
    valid, altitude_m = np.ones(shape, dtype=np.bool_), np.full(shape[0], 6.0)

    def unlike(found: Plane) -> float:
        one, other = (plane - ndimage.uniform_filter1d(plane, 101, axis=1) for plane in (found, relief))
        return 1.0 - float(np.corrcoef(one[:, 50:-50].ravel(), other[:, 50:-50].ravel())[0, 1])

    rows = []
    for floor, spread in (("one reflectivity", 0.0), ("patches of reflectivity", 0.35)):
        patches = ndimage.gaussian_filter(_random(10).normal(size=shape), 16, mode="wrap")
        scene = SeafloorScene(
            elevation_m=relief,
            reflectivity=np.exp(spread * patches / patches.std()),
            beam=BeamPattern(depression_rad=np.array([0.05, 1.5]), gain=np.ones(2)),
            altitude_m=altitude_m,
            along_m=along_m,
            column_spacing_m=column_m,
            valid=valid,
        )
        image = render_image(scene).intensity * _random(11).gamma(3.0, 1.0 / 3.0, shape)

        def ours(image: Plane = image) -> Plane:
            return invert(image, valid, altitude_m, along_m, column_m).elevation_m

        def added(image: Plane = image) -> Plane:
            return np.cumsum(image / ndimage.uniform_filter(image, (1, 101)) - 1.0, axis=1) * column_m

        (heights, cost), (sums, other) = timed(amount.repeat, ours, added)
        rows.append(
            StageRow(
                stage="inversion",
                setting=f"128 pings of 256 columns, {floor}",
                cost=cost,
                error=unlike(heights),
                unit="1 - correlation of heights",
                limit=0.5,
                alternative=Alternative(name="brightness added up", cost=other, error=unlike(sums)),
            )
        )
    return rows


def planner_rows(amount: Amount) -> list[StageRow]:
    """Plan second views under a budget; instead, try every set and order."""
    rows = []
    for n_contacts in (3,) if amount.n < 4 else (3, 5, 7, 9):
        worlds = []
        for number in range(amount.n):
            random = np.random.Generator(np.random.PCG64([tours.SEED, n_contacts, number]))
            world = tours.drawn_world(random, n_contacts, is_open=False)
            worlds.append((world, tours.LIMITS._replace(budget_m=float(random.uniform(300.0, 2000.0)), fence=None)))

        def ours(worlds: list[Any] = worlds) -> list[float]:
            return [replan(world, tours.START, limits, None, lambda: True).gain_m2 for world, limits in worlds]

        def exact(worlds: list[Any] = worlds) -> list[float]:
            return [tours.optimum_m2(world, limits) for world, limits in worlds]

        (gains, cost), (best, other) = timed(min(amount.repeat, 3), ours, exact)
        shares = [1.0 - gain / most for gain, most in zip(gains, best, strict=True) if most > 0.0]
        rows.append(
            StageRow(
                stage="planner",
                setting=f"{n_contacts} contacts, {amount.n} worlds",
                cost=cost,
                error=max(shares, default=0.0),
                unit="of the optimum not gained, worst",
                limit=1e-9,  # rounding
                alternative=Alternative(name="exact enumeration", cost=other, error=0.0),
            )
        )
    return rows


def framer_rows(amount: Amount) -> list[StageRow]:
    """Frame Ping Protocol, whole and damaged; instead, brping's parser."""
    random = _random(4)
    messages = framers.ping_stream_messages(random, 40 * amount.n)
    hurt = framers.damaged(messages, 10 * amount.n, random)
    streams = {"whole": b"".join(messages), "damaged": hurt.stream}
    has_brping = find_spec("brping") is not None
    rows = []
    for name, stream in streams.items():
        intact = hurt.intact if name == "damaged" else [True] * len(messages)
        done = timed(
            amount.repeat,
            lambda stream=stream: _framed(stream),  # type: ignore[misc]  # a default is its type
            *((lambda stream=stream: _by_brping(stream),) if has_brping else ()),
        )
        other = Alternative(name="brping", missing="brping is not installed: pip install bluerobotics-ping")
        if has_brping:
            lost = _lost(_by_brping(streams["whole"]), intact, done[1][0])
            other = Alternative(name="brping", cost=done[1][1], error=lost)
        rows.append(
            StageRow(
                stage="framers",
                setting=f"Ping Protocol, {name}, {len(stream)} bytes",
                cost=done[0][1],
                error=_lost(_framed(streams["whole"]), intact, done[0][0]),
                unit="intact messages lost",
                limit=0.0,
                alternative=other,
            )
        )
    return rows


def _framed(stream: bytes) -> list[Hashable]:
    framer = Framer(PingGrammar())
    found = [framed for at in range(0, len(stream), 4096) for framed in framer.feed(stream[at : at + 4096])]
    return [tuple(framed.message) for framed in found + framer.finish()]


def _by_brping(stream: bytes) -> list[Hashable]:
    brping = import_module("brping")
    parser, found = brping.PingParser(), list[Hashable]()
    with contextlib.redirect_stdout(io.StringIO()):  # it prints the numbers of messages that it does not know
        for byte in stream:
            if parser.parse_byte(byte) == brping.PingParser.NEW_MESSAGE:
                found.append(bytes(parser.rx_msg.msg_data))
    return found


def _lost(sent: list[Hashable], intact: list[bool], found: list[Hashable]) -> float:
    """Count intact messages that were not found, and those that were not even found among whole ones."""
    if len(sent) != len(intact):
        return float(abs(len(intact) - len(sent)))
    return float(framers.n_missing([message for message, whole in zip(sent, intact, strict=True) if whole], found))


STAGES: Final[dict[str, Callable[[Amount], list[StageRow]]]] = {
    "logs": log_rows,
    "waterfall": resampling_rows,
    "bottom": bottom_rows,
    "cascade": cascade_rows,
    "field": field_rows,
    "contours": contour_rows,
    "solids": solid_rows,
    "simulator": simulator_rows,
    "inversion": inversion_rows,
    "sea-floor": sea_floor_rows,
    "planner": planner_rows,
    "framers": framer_rows,
}
"""What measures each stage, in the order of the chain."""
