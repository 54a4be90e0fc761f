"""Measure how well relief, reflectivity and beam pattern are recovered from side-scan images, and in what time.

auv-mcm bench inversion [--seeds N] [--log FILE] [--markdown]

Made-up sea floors are rendered by the model that is inverted, with speckle: the two methods side by side. Then lines of
the simulator, which has other laws of scattering, layover, a beam of its own, and whose pings go through the chain's
waterfall. With --log, recorded lines, of which there is no truth but the image.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from auv_mcm.records import SIDES
from auv_mcm.settings.config import Config
from sim_replay.arguments import count
from sim_replay.augment.direct import invert, mean_spacing_m, multi_look
from sim_replay.augment.forward import BeamPattern, SeafloorScene, ground_range_m, render_image
from sim_replay.logs.recorded import RecordedMission
from sim_replay.simulator.bedforms import RippleTrain
from sim_replay.simulator.fields import Noise, Spectrum, gaussian, power_law
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.plan import local_frame
from sim_replay.simulator.scene import EXACT, STEADY, Lawnmower, Ripples, Scene, Seabed, Sonar, Track, World
from sim_replay.studies.coiras import invert_multiresolution
from sim_replay.studies.recorded_lines import LinePicture, waterfall_pictures

FloorKind: TypeAlias = Literal["flat", "ripple", "rough", "slope"]
FLOORS: Final[tuple[FloorKind, ...]] = get_args(FloorKind)
LOOKS: Final = (1, 4)

_N_ROWS, _N_COLUMNS = 240, 480
_COLUMN_M: Final = 0.08
_ROWS_PER_COLUMN: Final = 2
_ALTITUDE_M: Final = 5.0
_NOISE: Final = 0.01  # over the typical echo
_PERIODS: Final = (1000, 1127)
# Standard deviation of the mean that is taken off relief before it is compared: an image does not show slower waves
_SHORT_M: Final = 1.0
_EDGE_ROWS, _FIRST_M, _EDGE_COLUMNS = 10, 3.0, 20  # left out: ends, and what lies below the sonar
_RIPPLES: Final = Ripples(wavelength_m=1.2, height_m=0.16, direction_deg=60.0, defects=0.5, skew=0.5)
_SIMULATED: Final[dict[FloorKind, World]] = {
    "flat": World(seabeds=(Seabed(type="sand", relief_rms_m=0.02),)),
    "ripple": World(seabeds=(Seabed(type="rippled_sand", ripples=_RIPPLES),)),
    "rough": World(seabeds=(Seabed(type="gravel", relief_rms_m=0.05),), relief_rms_m=0.15, relief_outer_m=6.0),
    "slope": World(seabeds=(Seabed(type="sand", relief_rms_m=0.02),), slope_deg=5.0, slope_towards_deg=90.0),
}

Array = NDArray[np.float64]
Inversion: TypeAlias = Callable[[Array, NDArray[np.bool_], Array, Array, float], SeafloorScene]
METHODS: Final[dict[str, Inversion]] = {"direct": invert, "multiresolution": invert_multiresolution}

_HEADER: Final = (
    "sea floor",
    "looks",
    "method",
    "relief r",
    "gain",
    "reflectivity r",
    "re-render %",
    "re-render dB",
    "cpu s",
)


class Figures(NamedTuple):
    """Judge one inversion against the truth. relief, reflectivity: correlations, of short waves and of logarithms.
    gain: of short waves.

    error: root mean square of the render against the image without speckle, over the latter's. error_db: median
    magnitude of their ratio where both are lit. NaN where there is no truth.
    """

    relief: float
    gain: float
    reflectivity: float
    error: float
    error_db: float
    cpu_s: float


def made_up_scene(floor: FloorKind, seed: int) -> SeafloorScene:
    """Make a sea floor with patches of reflectivity, seen through a beam with side lobes.

    The height wanders by 0.4 m.
    """

    def field(name: str, spectrum: Spectrum, step: int = 1) -> Array:
        noise = Noise(seed, name, step=step, cell_m=_COLUMN_M, spectrum=spectrum, periods=_PERIODS, splined=step > 1)
        return noise.on_cells(0, 0, _ROWS_PER_COLUMN * _N_ROWS, _N_COLUMNS)[::_ROWS_PER_COLUMN].astype(np.float64)

    elevation = 0.02 * field("grain", power_law(4.0))
    match floor:
        case "ripple":
            train = RippleTrain(_RIPPLES, seed, "ripples", cell_m=_COLUMN_M)
            elevation += train.on_cells(0, 0, _ROWS_PER_COLUMN * _N_ROWS, _N_COLUMNS)[::_ROWS_PER_COLUMN]
        case "rough":
            elevation += 0.12 * field("reef", power_law(3.0, 4.0))
        case "slope":
            elevation += 0.1 * field("hills", power_law(6.0, 4.0))
            elevation += math.tan(math.radians(5.0)) * (ground_range_m(_N_COLUMNS, _COLUMN_M) - 10.0)
        case "flat":
            pass
    angles = np.radians(np.linspace(2.0, 89.0, 200))
    lobe = np.exp(-0.5 * ((angles - math.radians(25.0)) / math.radians(30.0)) ** 2) * (
        1.0 + 0.2 * np.sin(20.0 * angles + seed)
    )
    along_m = _ROWS_PER_COLUMN * _COLUMN_M * np.arange(_N_ROWS, dtype=np.float64)
    return SeafloorScene(
        elevation_m=elevation,
        reflectivity=np.exp(0.35 * field("reflectivity", gaussian(6.0), 16)),
        beam=BeamPattern(depression_rad=angles, gain=lobe),
        altitude_m=_ALTITUDE_M + 0.4 * np.sin(along_m / 9.0 + seed),
        along_m=along_m,
        column_spacing_m=_COLUMN_M,
        valid=np.ones(elevation.shape, dtype=np.bool_),
    )


def speckled(scene: SeafloorScene, looks: int, seed: int) -> Array:
    """Return the image of a scene with speckle and with noise 20 dB below the typical echo."""
    rendering = render_image(scene)
    noise = _NOISE * float(np.median(rendering.intensity[~rendering.shadow]))
    speckle = np.random.Generator(np.random.PCG64([seed, looks])).gamma(looks, 1.0 / looks, rendering.intensity.shape)
    return np.asarray((rendering.intensity + noise) * speckle)


def figures(truth: SeafloorScene, image: Array, method: Inversion) -> Figures:
    """Judge one inversion of an image of a known scene."""
    start = time.process_time()
    found = method(image, truth.valid, truth.altitude_m, truth.along_m, truth.column_spacing_m)
    cpu_s = time.process_time() - start
    relief, gain = _relief_agreement(found.elevation_m, truth.elevation_m, truth)
    seen = _inside(truth)
    error, error_db = _image_agreement(render_image(found).intensity[seen], render_image(truth).intensity[seen])
    reflectivity = _correlation(np.log(found.reflectivity[seen]), np.log(truth.reflectivity[seen]))
    return Figures(relief, gain, reflectivity, error, error_db, cpu_s)


def simulated_line(floor: FloorKind, seed: int, looks: int) -> tuple[LinePicture, Array]:
    """Simulate a line to starboard as the waterfall shows it, and the height of the floor in each pixel."""
    scene = Scene(
        seed=seed,
        world=_SIMULATED[floor],
        sonar=Sonar(range_m=40.0, looks=looks),
        track=Track(plan=Lawnmower(n_legs=1, leg_m=40.0), altitude_m=_ALTITUDE_M, motion=STEADY),
        navigation_error=EXACT,
    )
    mission = Mission(scene)
    picture = max(waterfall_pictures(mission.events(), Config(), "starboard"), key=lambda one: len(one.along_m))
    here = local_frame(scene.origin).to_enu(
        picture.pose.latitude_deg, picture.pose.longitude_deg, np.zeros(len(picture.along_m))
    )
    ground_m = ground_range_m(picture.intensity.shape[1], picture.column_spacing_m)
    heights = mission.sea.world.elevation_m(here[:, :1] + ground_m, here[:, 1:2] + 0.0 * ground_m)
    # The waterfall takes the floor for flat: what is higher is nearer by slant range, and shows nearer by.
    sonar_m = scene.world.depth_m - picture.pose.depth_m[:, None]
    slant_m = np.maximum(np.hypot(ground_m, sonar_m - heights), picture.altitude_m[:, None])
    shown_at_m = np.maximum.accumulate(np.sqrt(slant_m**2 - picture.altitude_m[:, None] ** 2), axis=1)
    shown = [np.interp(ground_m, place, height) for place, height in zip(shown_at_m, heights, strict=True)]
    return picture, np.array(shown)


def line_figures(picture: LinePicture, heights: Array | None, method: Inversion) -> Figures:
    """Judge one inversion of a line; its render is compared with the line itself, smoothed over a pixel or so."""
    start = time.process_time()
    found = method(picture.intensity, picture.valid, picture.altitude_m, picture.along_m, picture.column_spacing_m)
    cpu_s = time.process_time() - start
    relief, gain = (math.nan, math.nan) if heights is None else _relief_agreement(found.elevation_m, heights, found)
    seen = _inside(found)
    smooth = multi_look(picture.intensity, picture.valid).intensity
    error, error_db = _image_agreement(render_image(found).intensity[seen], smooth[seen])
    return Figures(relief, gain, math.nan, error, error_db, cpu_s)


def _inside(scene: SeafloorScene) -> NDArray[np.bool_]:
    seen = scene.valid.copy()
    seen[:_EDGE_ROWS] = seen[-_EDGE_ROWS:] = False
    seen[:, : round(_FIRST_M / scene.column_spacing_m)] = seen[:, -_EDGE_COLUMNS:] = False
    return seen


def _relief_agreement(found: Array, truth: Array, scene: SeafloorScene) -> tuple[float, float]:
    """Return correlation and gain of short waves."""
    sigma_px = (_SHORT_M / mean_spacing_m(scene.along_m), _SHORT_M / scene.column_spacing_m)
    seen = _inside(scene)
    one, other = ((plane - gaussian_filter(plane, sigma_px, mode="nearest"))[seen] for plane in (found, truth))
    return _correlation(one, other), float(one @ other / (other @ other))


def _image_agreement(found: Array, wanted: Array) -> tuple[float, float]:
    """Return the relative root mean square, and the median magnitude in dB where both are lit."""
    both = (found > 0.0) & (wanted > 0.0)
    ratio_db = 10.0 * np.abs(np.log10(found[both] / wanted[both]))
    return float(np.sqrt(((found - wanted) ** 2).sum() / (wanted**2).sum())), float(np.median(ratio_db))


def _correlation(one: Array, other: Array) -> float:
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add options of `auv-mcm bench inversion`."""
    parser.add_argument("--seeds", type=count, default=3, help="sea floors of each kind (default 3)")
    parser.add_argument(
        "--log",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="a recorded line to invert, XTF; repeatable",
    )
    parser.add_argument("--markdown", action="store_true", help="print tables in Markdown")


def run(chosen: argparse.Namespace) -> int:
    """Print the tables; returns the exit code. Raises BadInputError for a log that cannot be read."""
    seeds = range(1, chosen.seeds + 1)
    print("Sea floors rendered by the model itself, against the image without speckle:\n")
    print(_laid_out(list(_made_up_rows(seeds)), chosen.markdown))
    print("\nLines of the simulator through the waterfall, against the smoothed image:\n")
    print(_laid_out(list(_simulated_rows(seeds)), chosen.markdown))
    if chosen.log:
        print("\nRecorded lines, against the smoothed image:\n")
        print(_laid_out([row for log in chosen.log for row in _recorded_rows(log)], chosen.markdown))
    return 0


def _made_up_rows(seeds: Sequence[int]) -> Iterator[Sequence[str]]:
    for floor in FLOORS:
        for looks in LOOKS:
            scenes = [made_up_scene(floor, seed) for seed in seeds]
            images = [speckled(scene, looks, seed) for scene, seed in zip(scenes, seeds, strict=True)]
            for name, method in METHODS.items():
                yield (
                    floor,
                    str(looks),
                    name,
                    *_cells([figures(s, image, method) for s, image in zip(scenes, images, strict=True)]),
                )


def _simulated_rows(seeds: Sequence[int]) -> Iterator[Sequence[str]]:
    for floor in FLOORS:
        for looks in LOOKS:
            lines = [simulated_line(floor, seed, looks) for seed in seeds]
            for name, method in METHODS.items():
                yield (
                    floor,
                    str(looks),
                    name,
                    *_cells([line_figures(picture, heights, method) for picture, heights in lines]),
                )


def _recorded_rows(log: Path) -> Iterator[Sequence[str]]:
    config = Config()
    for side in SIDES:
        pictures = list(waterfall_pictures(RecordedMission([log], config).events(), config, side))
        if not pictures:
            continue
        for name, method in METHODS.items():
            yield (
                f"{log.name} {side}",
                "-",
                name,
                *_cells([line_figures(picture, None, method) for picture in pictures]),
            )


def _cells(found: Sequence[Figures]) -> tuple[str, ...]:
    """Format means over inversions as a row."""
    mean = Figures(*(statistics.fmean(values) for values in zip(*found, strict=True)))
    cells = (
        f"{mean.relief:.2f}",
        f"{mean.gain:.2f}",
        f"{mean.reflectivity:.2f}",
        f"{100.0 * mean.error:.0f}",
        f"{mean.error_db:.1f}",
    )
    return *("-" if cell == "nan" else cell for cell in cells), f"{mean.cpu_s:.2f}"


def _laid_out(rows: Sequence[Sequence[str]], markdown: bool) -> str:
    if markdown:
        return "\n".join(f"| {' | '.join(row)} |" for row in (_HEADER, ["---"] * len(_HEADER), *rows))
    widths = [max(len(row[column]) for row in (_HEADER, *rows)) for column in range(len(_HEADER))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in (_HEADER, *rows)
    )
