"""Write a small sound file of everything that a person gives the program: logs, images, sidecars, configurations.

They are what `auv-mcm bench mutants --all` damages.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
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
from drivers.ports import read_ports
from drivers.recording.session_layout import Recorded, SessionDescription
from drivers.recording.session_writer import SessionWriter
from drivers.sonar.jsf_messages import JsfMessage
from drivers.sonar.jsf_messages import to_wire as jsf_wire
from drivers.sonar.ping_messages import NMEA_WRAPPER, JsonWrapper, PingMessage, encode
from drivers.sonar.ping_messages import to_wire as ping_wire
from sim_replay.benches.recorder_files import write_humminbird, write_lowrance, write_sdf
from sim_replay.fakes.device import SONARS
from sim_replay.fakes.navigation import Nmea0183Unit
from sim_replay.fakes.sonar import DeviceTime
from sim_replay.logs.image_sidecar import sidecar_path
from sim_replay.logs.xtf_writer import write_xtf
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, Scene, SceneObject, Sonar, Track

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
        *(_log(folder, name, file, write) for name, file, write in _LOGS),
        *(_image(folder, name, file, write, changes) for name, file, write, changes in _IMAGES),
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
def _received(device: str) -> tuple[Config, tuple[Recorded, ...]]:
    """Let a fake sonar and a satellite compass sail the mission: the ports' configuration, and what came in there."""
    ports = [
        {
            "name": "sonar",
            "link": "tcp://192.168.2.92:51200",
            "device": device,
            "sonar": {"range_m": _RANGE_M, "n_samples": _N_SAMPLES},
        },
        {"name": "compass", "link": "tcp://192.168.2.93:2000", "device": "nmea0183"},
    ]
    config = parse_config(yaml.safe_dump({"ports": ports}), "the seed")
    sonar, unit = SONARS[device](), Nmea0183Unit()
    for command in read_ports(config)[0].commands:
        sonar.heard(command, DeviceTime(0.0, _UTC_S))
    start_s = _mission()[0].time_s
    received: list[Recorded] = []
    for event in _mission():
        at_s = round(event.time_s - start_s, 3)
        stamp = Stamp(round(at_s * 1e9), round((_UTC_S + at_s) * 1e9))
        messages: Sequence[Any]
        if isinstance(event, NavSample):
            messages = unit.measured(event, _UTC_S + at_s)
        else:
            messages = sonar.ping(event, DeviceTime(at_s, _UTC_S + at_s))
        port = "compass" if isinstance(event, NavSample) else "sonar"
        data = b"".join(bytes(message) for message in messages)  # type: ignore[arg-type]  # no frame of a bus
        received.append(Recorded(port, "in", stamp, data))
    return config, tuple(received)


def _xtf(path: Path) -> None:
    write_xtf(path, _mission())


def _jsf(path: Path) -> None:
    """Write what EdgeTech's topside records: sentences in messages of type 2002."""
    parts = []
    for recorded in _received("jsf")[1]:
        seconds, nanoseconds = divmod(recorded.stamp.utc_ns, 1_000_000_000)
        head = seconds.to_bytes(4, "little") + (nanoseconds // 1_000_000).to_bytes(4, "little") + bytes(4)
        for line in recorded.data.splitlines(keepends=True) if recorded.port == "compass" else ():
            parts.append(jsf_wire(JsfMessage(2002, head + line + b"\0", subsystem=101)))
        if recorded.port == "sonar":
            parts.append(recorded.data)
    path.write_bytes(b"".join(parts))


def _svlog(path: Path) -> None:
    """Write what SonarView records: a head with the time, then packets, and sentences in packets of their own."""
    parts = [encode(JsonWrapper({"session_id": 1, "timestamp": "2026-06-01T10:00:00+00:00"}))]
    for recorded in _received("ping_protocol")[1]:
        if recorded.port == "sonar":
            parts.append(recorded.data)
        else:
            lines = recorded.data.splitlines(keepends=True)
            parts += [ping_wire(PingMessage(NMEA_WRAPPER, line)) for line in lines]
    path.write_bytes(b"".join(parts))


def _humminbird(path: Path) -> None:
    write_humminbird(path.with_name("Rec00001.DAT"), _mission(), son=path.parent)


def _sdf(path: Path, version: int) -> None:
    write_sdf(path, _mission(), version=version)


def _session(path: Path) -> None:
    config, received = _received("jsf")
    folder = path.parent / "recording"
    description = SessionDescription(
        version="0.1.0", started=received[0].stamp, config_yaml=config_yaml(config), ports=()
    )
    writer = SessionWriter(folder, description)
    for recorded in received:
        writer.add(recorded)
    writer.close()
    (file,) = folder.iterdir()
    file.rename(path)
    folder.rmdir()


_LOGS: Final[tuple[tuple[str, str, Callable[[Path], None]], ...]] = (
    ("XTF", "log.xtf", _xtf),
    ("JSF", "log.jsf", _jsf),
    ("svlog", "log.svlog", _svlog),
    ("recorded session", "log.mcap", _session),
    ("SL2", "log.sl2", lambda path: write_lowrance(path, _mission())),
    ("SL3", "log.sl3", lambda path: write_lowrance(path, _mission(), version=3, composite=False)),
    ("Humminbird", "B002.SON", _humminbird),
    *((f"SDF {page}", f"log{page}.sdf", partial(_sdf, version=page)) for page in (3000, 3502, 5004)),
)


def _log(folder: Path, name: str, file: str, write: Callable[[Path], None]) -> Seed:
    own = folder / file.replace(".", "-")
    own.mkdir(parents=True)
    write(own / file)
    return Seed(name, "log", own, file, ("replay", file, "--out", "out"))


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


def _image(folder: Path, name: str, file: str, write: Callable[[Path], Any], changes: dict[str, Any]) -> Seed:
    own = folder / file.replace(".", "-")
    own.mkdir(parents=True)
    write(own / file)
    write_sidecar(own / file, changes)
    return Seed(name, "image", own, file, ("replay", file, "--out", "out"))


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
