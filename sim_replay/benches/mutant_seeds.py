"""Write a small sound file of everything that a person gives the program: logs, images, sidecars, configurations.

They are what `auv-mcm bench mutants --all` damages.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import cv2
import h5py
import numpy as np
import tifffile
import yaml

from auv_mcm.clock import Stamp
from auv_mcm.records import NavSample, Ping
from auv_mcm.settings.config import Config, config_yaml, parse_config
from sim_replay.benches.recorder_files import write_humminbird, write_lowrance, write_sdf
from sim_replay.logs.image_sidecar import sidecar_path
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, Scene, SceneObject, Sonar, Track
from sim_replay.wire_logs import Run, played, write_jsf, write_session, write_svlog

Role = Literal["log", "image", "sidecar", "track", "configuration", "scene", "mine list"]

_UTC_S: Final = 1_780_308_000.0  # when the mission begins, 2026-06-01T10:00:00Z
_RANGE_M: Final = 20.0  # of the sonar: short logs. Chosen
_N_SAMPLES: Final = 300  # of a side
_LINES, _PIXELS = 48, 96  # of the images
_LINE_M: Final = 0.1  # along the track
_BASE: Final = "base.npy"  # the image that a damaged sidecar, track, configuration or list goes with
_LATITUDE_DEG, _LONGITUDE_DEG = 43.0, 5.5  # where the images begin
_METRES_PER_DEGREE: Final = 111_120.0  # of latitude: a nautical mile has 1852 m


class Seed(NamedTuple):
    """Hold a sound file in a folder of its own with all that belongs to it.

    file: the name of what is damaged. arguments: of the command that reads it; none for a scene, which is only read.
    """

    name: str
    role: Role
    folder: Path
    file: str
    arguments: tuple[str, ...]


def write_seeds(folder: Path) -> list[Seed]:
    """Write a seed of every format and role below a folder."""
    return [
        *(_written(folder, *log) for log in _LOGS),
        *(_written(folder, *image) for image in _IMAGES),
        _beside(folder, "sidecar", sidecar_path(Path(_BASE)).name, ""),
        _beside(folder, "track", "track.csv", ""),
        _beside(folder, "configuration", "config.yaml", config_yaml(Config()), "--config", "config.yaml"),
        _beside(folder, "mine list", "mines.yaml", _MINES, "--config", "config.yaml"),
        _beside(folder, "scene", "scene.yaml", _SCENE),
    ]


# --- logs ------------------------------------------------------------------------------------------------------------


@cache
def _mission() -> tuple[NavSample | Ping, ...]:
    """Fly a straight line past a box."""
    box = SceneObject(kind="box", leg=0, along_m=6.0, across_m=9.0, length_m=0.9, width_m=0.7, height_m=0.45)
    sonar = Sonar(range_m=_RANGE_M, n_samples=_N_SAMPLES, ping_rate_hz=6.0, beam_lines=3)
    track = Track(plan=Lawnmower(heading_deg=20.0, n_legs=1, leg_m=12.0), altitude_m=5.0)
    return tuple(Mission(Scene(objects=(box,), sonar=sonar, track=track)).events())


@cache
def _received(device: str) -> Run:
    """Let a fake sonar and a satellite compass sail the mission."""
    sonar = f"device: {device}, sonar: {{range_m: {_RANGE_M}, n_samples: {_N_SAMPLES}}}"
    text = f"""
ports:
  - {{name: sonar, link: "tcp://192.168.2.92:51200", {sonar}}}
  - {{name: compass, link: "tcp://192.168.2.93:2000", device: nmea0183}}
"""
    config = parse_config(text, "the seed")
    return played(_mission(), config, Stamp(0, round(_UTC_S * 1e9)))


def _session(path: Path) -> None:
    folder = write_session(_received("jsf"), path.parent / "recording")
    (file,) = folder.iterdir()
    file.rename(path)
    folder.rmdir()


_LOGS: Final[tuple[tuple[str, str, Callable[[Path], Any]], ...]] = (
    ("XTF", "log.xtf", lambda path: write_xtf(path, _mission())),
    ("JSF", "log.jsf", lambda path: write_jsf(_received("jsf"), path)),
    ("svlog", "log.svlog", lambda path: write_svlog(_received("ping_protocol"), path)),
    ("recorded session", "log.mcap", _session),
    ("SL2", "log.sl2", lambda path: write_lowrance(path, _mission())),
    ("SL3", "log.sl3", lambda path: write_lowrance(path, _mission(), version=3, composite=False)),
    ("Humminbird", "B002.SON", lambda path: write_humminbird(path.with_name("R.DAT"), _mission(), son=path.parent)),
    *(
        (f"SDF {page}", f"log{page}.sdf", lambda path, page=page: write_sdf(path, _mission(), version=page))
        for page in (3000, 3502, 5004)
    ),
)


# --- images ----------------------------------------------------------------------------------------------------------


def _amplitude() -> Any:
    random = np.random.default_rng(2)
    return (np.sqrt(random.exponential(1.0, (_LINES, _PIXELS))) * 40.0 + 1.0).astype(np.float32)


def _tiff(**options: Any) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        tifffile.imwrite(path, (_amplitude() * 100.0).astype(np.uint16), photometric="minisblack", **options)

    return write


def _png(dtype: Any) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        cv2.imwrite(str(path), np.clip(_amplitude(), 0.0, 255.0).astype(dtype))

    return write


def _complex() -> Any:
    return (_amplitude() * (1.0 + 1.0j)).astype(np.complex64)


def _hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("image", data=_amplitude(), chunks=(16, _PIXELS), compression="gzip", shuffle=True)
        file.create_dataset("group/other", data=_amplitude()[:4])


def _complex_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["image"] = _complex()


_COMPLEX: Final = {"samples": "complex", "looks": 2}
_IMAGES: Final[tuple[tuple[str, str, Callable[[Path], Any], dict[str, Any]], ...]] = (
    ("TIFF", "plain.tif", _tiff(), {}),
    ("TIFF, deflate", "deflate.tif", _tiff(compression="zlib", rowsperstrip=16), {}),
    ("TIFF, tiles", "tiles.tif", _tiff(compression="zlib", predictor=True, tile=(16, 32)), {}),
    ("BigTIFF", "big.tif", _tiff(bigtiff=True, byteorder=">"), {}),
    ("PNG, 8 bits", "eight.png", _png(np.uint8), {}),
    ("PNG, 16 bits", "sixteen.png", _png(np.uint16), {}),
    ("npy", "plain.npy", lambda path: np.save(path, _amplitude()), {}),
    ("npy, complex", "complex.npy", lambda path: np.save(path, _complex()), _COMPLEX),
    ("HDF5", "chunks.h5", _hdf5, {"dataset": "image"}),
    ("HDF5, complex", "complex.h5", _complex_hdf5, _COMPLEX | {"dataset": "image"}),
)


def _written(
    folder: Path, name: str, file: str, write: Callable[[Path], Any], changes: dict[str, Any] | None = None
) -> Seed:
    own = folder / file.replace(".", "-")
    own.mkdir(parents=True)
    write(own / file)
    if changes is not None:
        write_sidecar(own / file, changes)
    return Seed(name, "log" if changes is None else "image", own, file, ("replay", file, "--out", "out"))


def write_sidecar(image: Path, changes: dict[str, Any]) -> None:
    """Write sidecar and track beside an image of the size of the seeds, with other keys than theirs."""
    sidecar = {
        "side": "starboard",
        "near_edge": "left",
        "pixel_along_m": _LINE_M,
        "pixel_across_m": 0.1,
        "range": "ground",
        "near_range_m": 10.0,
        "altitude_m": 6.0,
        "samples": "amplitude",
        "start_time": "2026-06-01T10:00:00Z",
        "speed_mps": 1.5,
        "track": "track.csv",
        **changes,
    }
    sidecar_path(image).write_text(yaml.safe_dump(sidecar), "utf-8")
    rows = (
        f"{line},{_LATITUDE_DEG + line * _LINE_M / _METRES_PER_DEGREE:.9f},{_LONGITUDE_DEG},{0.1 * line},6.0"
        for line in range(0, _LINES + 4, 3)
    )
    header = "line,latitude_deg,longitude_deg,heading_deg,altitude_m"
    (image.parent / "track.csv").write_text("\n".join((header, *rows, "")), "utf-8")


# --- what goes with an image -----------------------------------------------------------------------------------------

_MINES: Final = """\
not_listed: 0.3
mines:
  - {name: round, kind: sphere, diameter_m: 0.6, tolerance_percent: 20}
  - {kind: cylinder, length_m: 2.0, diameter_m: 0.5}
"""
_SCENE: Final = """\
world: {depth_m: 20, seabeds: [{type: sand, share: 0.7}, {type: rippled_sand, share: 0.3}]}
sonar: {frequency_khz: 450, range_m: 50}
track: {altitude_m: 6, plan: {pattern: lawnmower, n_legs: 2, leg_m: 150, spacing_m: 60}}
objects: [{kind: cylinder, leg: 0, along_m: 70, across_m: 20, azimuth_deg: 30}]
scatter: [{kind: rock, count: 10}]
"""


def _beside(folder: Path, role: Role, file: str, text: str, *options: str) -> Seed:
    own = folder / role.replace(" ", "-")
    own.mkdir(parents=True)
    np.save(own / _BASE, _amplitude())
    write_sidecar(own / _BASE, {})
    (own / "config.yaml").write_text("confirm: {targets: mines.yaml}\n", "utf-8")
    if text:
        (own / file).write_text(text, "utf-8")
    arguments = () if role == "scene" else ("replay", _BASE, "--out", "out", *options)
    return Seed(role, role, own, file, arguments)
