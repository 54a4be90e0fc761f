"""Write a mission for other programs."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from auv_mcm.commands import Commands, Progress, add_config_option, add_json_option, answer, command, read_config
from auv_mcm.errors import BadInputError, UsageError

PALETTES: Final = ("copper", "grey", "viridis", "inferno")  # as of sim_replay.mosaic_files, which needs OpenCV
BLENDS: Final = ("mean", "nearest", "max", "last")  # as of sim_replay.mosaic, for the same reason

if TYPE_CHECKING:
    from auv_mcm.records import Tile
    from sim_replay.export_source import ExportSource
    from sim_replay.mosaic import Level

DEFAULT_RESOLUTION_M: Final = 0.25
"""Pixel of a mosaic unless asked otherwise: a mine of half a metre has two of them, and 40 minutes take 11 MB."""
_FINEST_M, _COARSEST_M = 0.02, 100.0  # m, of a pixel: sonars resolve centimetres, and a swath fits into one (chosen)


def add(commands: Commands) -> None:
    """Add `auv-mcm export` to the command line."""
    parser = command(
        commands,
        "export",
        "write a mission for other programs: mosaic, layers, MCAP",
        "SOURCE is a folder of results ('auv-mcm replay --out'), the folder of a session ('auv-mcm run', also while\n"
        "it runs), or logs. Positions are longitude and latitude, WGS 84 (EPSG:4326). The mosaic blends all passes\n"
        "over a place, the better seen the more. GeoPackage, GPX, KML and GeoJSON need results: contacts with the\n"
        "verdicts of 'auv-mcm view', objects that only people saw; track, coverage and proposed legs, each purpose in\n"
        "a layer of its own.",
        [
            "auv-mcm export results --geotiff mosaic.tif --gpkg mission.gpkg --gpx mission.gpx",
            "auv-mcm export mission.xtf --geotiff mosaic.tif --kmz mosaic.kmz --resolution 0.1",
            "auv-mcm export auv-mcm-out/latest --kmz mosaic.kmz",
            "auv-mcm export results --kml judged.kml --geojson judged.geojson",
            "auv-mcm export results --mcap mission.mcap",
            "auv-mcm export results --qgis mission.qgs --crs utm --gain survey --fade-nadir 0.3",
            "auv-mcm export results --pdf contacts.pdf --coco chips",
        ],
    )
    parser.add_argument(
        "source", metavar="SOURCE", nargs="+", type=Path, help="folder of results, folder of a session, or logs"
    )
    _add_files(parser)
    _add_mosaic(parser)
    add_config_option(parser)
    add_json_option(parser)
    parser.set_defaults(command=_run)


def _add_files(parser: argparse.ArgumentParser) -> None:
    """Add the options that name what is written."""
    parser.add_argument(
        "--geotiff",
        metavar="FILE",
        type=Path,
        help="mosaic with overviews: band 1 is the echo in dB, band 2 the 1-sigma error of position in m",
    )
    parser.add_argument(
        "--kmz", metavar="FILE", type=Path, help="mosaic as a ground overlay, with contacts where there are results"
    )
    parser.add_argument(
        "--mcap", metavar="FILE", type=Path, help="track, waterfall, contacts and maps as messages of Foxglove"
    )
    parser.add_argument("--gpkg", metavar="FILE", type=Path, help="GeoPackage of everything that has a place")
    parser.add_argument(
        "--gpx", metavar="FILE", type=Path, help="mine-like contacts, proposed legs and the track, for a chart plotter"
    )
    parser.add_argument(
        "--qgis",
        metavar="FILE.qgs",
        type=Path,
        help="QGIS project of the mosaic and the layers; makes FILE.tif and FILE.gpkg unless --geotiff and --gpkg name "
        "them",
    )
    parser.add_argument("--kml", metavar="FILE", type=Path, help="contacts with verdicts, and missed ones")
    parser.add_argument("--geojson", metavar="FILE", type=Path, help="the same as GeoJSON")
    parser.add_argument(
        "--pdf", metavar="FILE", type=Path, help="contact sheet to print: chart, pictures, places and verdicts"
    )
    parser.add_argument("--coco", metavar="DIR", type=Path, help="judged contacts as chips with boxes, for training")
    parser.add_argument("--yolo", metavar="DIR", type=Path, help="the same as YOLO reads them")


def _add_mosaic(parser: argparse.ArgumentParser) -> None:
    """Add the options of the mosaic."""
    parser.add_argument(
        "--resolution",
        metavar="M",
        type=_metres(_FINEST_M, _COARSEST_M),
        default=DEFAULT_RESOLUTION_M,
        help=f"pixel of the mosaic, m (default {DEFAULT_RESOLUTION_M:g})",
    )
    parser.add_argument(
        "--max-sigma",
        metavar="M",
        type=_metres(0.0),
        default=math.inf,
        help="leave out of the mosaic what is placed worse than this, 1-sigma in m (default: nothing)",
    )
    parser.add_argument(
        "--crs",
        metavar="utm|EPSG:CODE",
        default="",
        help="reference system of the GeoTIFF, projected in metres (default: longitude and latitude, WGS 84)",
    )
    parser.add_argument(
        "--blend",
        choices=BLENDS,
        default="mean",
        help="what is shown where several passes saw a place: all by weight (default), or the one that sees best, the "
        "brightest or the last, which keep shadows",
    )
    parser.add_argument(
        "--per-leg",
        action="store_true",
        help="a GeoTIFF for each leg, FILE-1.tif and on, so that no pass hides another",
    )
    parser.add_argument(
        "--palette", choices=PALETTES, default="", help="GeoTIFF in colour, in place of decibels and errors"
    )
    for option, change in (
        ("--mask-nadir", "leave out {}; 0.3 hides the bright line below the vehicle (default 0)"),
        ("--fade-nadir", "fade {} into the floor around, below other passes (default 0)"),
    ):
        near = change.format("what is nearer to the track than this share of the altitude")
        parser.add_argument(option, metavar="SHARE", type=_metres(0.0), default=0.0, help=near)
    parser.add_argument(
        "--gain",
        choices=("local", "survey"),
        default="local",
        help="local: echoes against the floor within a few metres (default); survey: against the mean of the whole "
        "survey at their range and angle, so that kinds of sea floor differ; reads the logs twice",
    )


def _metres(low_m: float, high_m: float = math.inf) -> Callable[[str], float]:
    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (low_m <= value <= high_m and math.isfinite(value)):
            end = "on" if high_m == math.inf else f"to {high_m:g}"
            raise argparse.ArgumentTypeError(f"'{text}' is not a number of metres from {low_m:g} {end}")
        return value

    return parse


def _run(arguments: argparse.Namespace) -> int:
    from sim_replay.export_source import TRACK, find_source

    if arguments.qgis is not None:
        _check_target(arguments.qgis)
        arguments.geotiff = arguments.geotiff or arguments.qgis.with_suffix(".tif")
        arguments.gpkg = arguments.gpkg or arguments.qgis.with_suffix(".gpkg")
    vectors = (arguments.gpkg, arguments.gpx, arguments.kml, arguments.geojson, arguments.pdf)
    chips = (arguments.coco, arguments.yolo)
    wanted = [path for path in (arguments.geotiff, arguments.kmz, *vectors, arguments.mcap, *chips) if path is not None]
    if not wanted:
        raise UsageError(
            "nothing to export: name --geotiff, --qgis, --kmz, --gpkg, --gpx, --kml, --geojson, --mcap, --pdf, --coco "
            "or --yolo"
        )
    for path in wanted:
        _check_target(path, is_folder=path in chips)
    missing = next((path for path in arguments.source if not path.exists()), None)
    if missing is not None:
        raise UsageError(f"there is no {missing}. Name a folder of results, the folder of a session, or logs.")
    source = find_source(arguments.source, None if arguments.config is None else read_config(arguments.config))
    _check_apart([path for path in (*wanted, arguments.qgis) if path is not None and path not in chips], source)
    name = source.config.mission or (source.results or source.logs[0]).resolve().stem
    if any(path is not None for path in chips):  # first, since it fails where nothing was judged
        _write_chips(source, arguments, name)
    if any(path is not None for path in vectors):
        _write_vectors(source, arguments, name)
    left: list[Path] = []
    if arguments.geotiff is not None or arguments.kmz is not None:
        written = _write_mosaic(source, arguments, name)
        wanted[:1] = written or wanted[:1]
        left = _left_over(arguments.geotiff, len(written)) if arguments.per_leg else []
    if arguments.qgis is not None:
        wanted.append(arguments.qgis)
    if arguments.mcap is not None:
        _write_mcap(source, arguments.mcap)
    notices = [
        f"{path} was there before and does not belong to this export: remove it unless it is your own" for path in left
    ]
    if (arguments.gpkg or arguments.gpx) and source.results is not None and not (source.results / TRACK).is_file():
        notices.append(
            f"the track is not in it, as {source.results} holds none. Of a session, 'auv-mcm report' makes results "
            "with a track, which can be exported."
        )
    answer(
        {"written": wanted, **({"notices": notices} if notices else {})},
        [*(f"written: {path}" for path in wanted), *(f"notice: {text}" for text in notices)],
        as_json=arguments.json,
    )
    return 0


def _leg_path(path: Path, number: int) -> Path:
    return path.with_name(f"{path.stem}-{number}{path.suffix}")


def _left_over(path: Path, n_legs: int) -> list[Path]:
    """List files that are named as further legs would be: an earlier export had more."""
    left: list[Path] = []
    while (further := _leg_path(path, n_legs + len(left) + 1)).exists():
        left.append(further)
    return left


def _check_target(path: Path, *, is_folder: bool = False) -> None:
    """Check early that a file, or a folder, can be made. Raises UsageError if it cannot."""
    if not path.absolute().parent.is_dir():
        raise UsageError(f"{path} cannot be written: there is no folder {path.parent}. Make it first.")
    if path.exists() and not path.is_file() and not is_folder:
        raise UsageError(f"{path} cannot be written: it is a folder or a device. Name a file.")


def _check_apart(targets: list[Path], source: ExportSource) -> None:
    """Check that no file is written twice, and none that the export is made of. Raises UsageError."""
    places = [path.resolve() for path in targets]
    for number, (path, place) in enumerate(zip(targets, places, strict=True)):
        if source.keeps(path):
            raise UsageError(f"{path} is what this export is made of, and is never overwritten. Name another file.")
        if place in places[:number]:
            raise UsageError(f"{path} would be written twice, for two options. Name a file for each.")


def _write_vectors(source: ExportSource, arguments: argparse.Namespace, name: str) -> None:
    from sim_replay.geopackage import write_geopackage
    from sim_replay.vector_layers import read_layers, write_gpx
    from sim_replay.verdict_layers import write_geojson, write_kml

    if source.results is None:
        raise UsageError(
            "GeoPackage, GPX, KML, GeoJSON and PDF are made of results: replay the log first ('auv-mcm replay "
            "LOG --out results'), and export that folder."
        )
    layers = read_layers(source.results)
    if arguments.gpkg is not None:
        write_geopackage(arguments.gpkg, layers)
    if arguments.gpx is not None:
        write_gpx(arguments.gpx, layers, name)
    if arguments.kml is not None:
        write_kml(arguments.kml, layers, name, source.results)
    if arguments.geojson is not None:
        write_geojson(arguments.geojson, layers)
    if arguments.pdf is not None:
        from sim_replay.contact_sheet import write_contact_sheet

        write_contact_sheet(arguments.pdf, source.results, layers, name)


def _write_chips(source: ExportSource, arguments: argparse.Namespace, name: str) -> None:
    from sim_replay.report.report_file import read_contents
    from sim_replay.training_export import judged_chips, write_coco, write_yolo

    if source.results is None:
        raise UsageError("chips are made of results: replay the log first, judge its contacts, and export that folder")
    chips = judged_chips(source.results, read_contents(source.results))
    if arguments.coco is not None:
        write_coco(arguments.coco, chips, name)
    if arguments.yolo is not None:
        write_yolo(arguments.yolo, chips)


def _write_mcap(source: ExportSource, path: Path) -> None:
    from sim_replay.export_source import tiles
    from sim_replay.mcap_export import write_mcap
    from sim_replay.vector_layers import read_layers

    layers = {} if source.results is None else read_layers(source.results)
    with Progress("MCAP") as progress:
        write_mcap(path, tiles(source, progress.show), layers)


def _write_mosaic(source: ExportSource, arguments: argparse.Namespace, name: str) -> list[Path]:
    """Write the mosaic; list the files of its legs."""
    if arguments.kmz is not None and (arguments.crs or arguments.per_leg):
        raise UsageError(
            "a KMZ is one picture in longitude and latitude: leave --crs and --per-leg out, or export it apart"
        )
    legs = _mosaics(source, arguments)
    written = []
    if arguments.geotiff is not None:
        from sim_replay.mosaic_files import write_geotiff

        for number, levels in enumerate(legs, 1):
            path = arguments.geotiff
            if arguments.per_leg:
                path = _leg_path(path, number)
            _check_apart([path], source)
            write_geotiff(path, levels, arguments.max_sigma, arguments.palette)
            written.append(path)
    if arguments.qgis is not None:
        _write_project(source, arguments, name, written, [levels[0] for levels in legs])
    if arguments.kmz is not None:
        from sim_replay.mosaic_files import write_kmz
        from sim_replay.vector_layers import read_layers
        from sim_replay.verdict_layers import kml_folders

        folders = () if source.results is None else kml_folders(read_layers(source.results))
        write_kmz(arguments.kmz, legs[0], name, arguments.max_sigma, folders)
    return written


def _write_project(
    source: ExportSource, arguments: argparse.Namespace, name: str, mosaics: list[Path], finest: list[Level]
) -> None:
    from sim_replay.mosaic import Box
    from sim_replay.qgis import write_project
    from sim_replay.vector_layers import read_layers

    assert source.results is not None
    boxes = [level.box(0, 0, level.width, level.height) for level in finest]
    bounds = (min, min, max, max)
    outline = Box(*(bound(box[side] for box in boxes) for side, bound in enumerate(bounds)))
    layers = read_layers(source.results)
    write_project(
        arguments.qgis, mosaics, layers, arguments.gpkg, name, outline, finest[0].epsg, bool(arguments.palette)
    )


def _mosaics(source: ExportSource, arguments: argparse.Namespace) -> list[list[Level]]:
    """Draw the mosaic, or one for each leg."""
    from sim_replay.mosaic import Mosaic
    from sim_replay.mosaic_legs import leg_numbers
    from sim_replay.projections import check_crs

    crs = check_crs(arguments.crs) if arguments.crs else ""
    legs: dict[int, Mosaic] = {}
    number_of = leg_numbers() if arguments.per_leg else lambda tile: 1
    for tile in _levelled(source, arguments.gain):
        number = number_of(tile)
        if number not in legs:
            legs[number] = Mosaic(
                source.config,
                arguments.resolution,
                blend=arguments.blend,
                crs=crs,
                nadir_share=arguments.mask_nadir,
                fade_share=arguments.fade_nadir,
            )
        legs[number].add(tile)
        crs = legs[number].crs  # of UTM one zone for all legs
    found = [levels for mosaic in legs.values() if (levels := list(mosaic.levels()))]
    if not found:
        raise BadInputError("nothing has a place, so there is no mosaic. Check the navigation, and --mask-nadir.")
    return found


def _levelled(source: ExportSource, gain: str) -> Iterator[Tile]:
    """Make the tiles of the mosaic, with the gain of each place or of the whole survey taken off."""
    from sim_replay.export_source import tiles

    if gain == "local":
        with Progress("mosaic") as progress:
            yield from tiles(source, progress.show)
        return
    from sim_replay.survey_gain import SurveyGain

    survey = SurveyGain()
    with Progress("gain of the survey") as progress:
        for tile in tiles(source, progress.show, reference_pings=0.0):
            survey.learn(tile)
    with Progress("mosaic") as progress:
        yield from map(survey.applied, tiles(source, progress.show, reference_pings=0.0))
