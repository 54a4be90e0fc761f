"""Made-up missions for the tests of the page: a waterfall of known pixels, and a folder of results."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.contacts.contact_picture import encoded
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import SIDES, VALID, PoseTrack, Side, Tile
from sim_replay.view.mission import ShownMission
from sim_replay.view.mission_feed import MissionFeed, OpenedMission
from sim_replay.view.waterfall_store import WaterfallStore
from tests.make.records import straight_pose, tile_with

ROW_M, COLUMN_M, ALTITUDE_M, DEPTH_M = 0.12, 0.06, 5.0, 10.0
HOME = LocalFrame(latitude_deg=54.1, longitude_deg=10.2)
START_S = 1_780_000_000.0
SPEED_MPS = 2.0


def position(east_m: float, north_m: float) -> tuple[float, float]:
    """Latitude and longitude of a place about HOME."""
    latitude, longitude, _ = HOME.to_geodetic(np.array([[east_m, north_m, 0.0]]))
    return float(latitude[0]), float(longitude[0])


def poses(first_row: int, n_rows: int) -> PoseTrack:
    """A vehicle that sails due north at 2 m/s, row by row; its way during a ping is left out: 5 cm at 40 m."""
    home_deg = HOME.latitude_deg, HOME.longitude_deg
    sailed = straight_pose(n_rows, ROW_M, home_deg, first_row=first_row, speed_mps=SPEED_MPS, start_s=START_S)
    return structs.replace(
        sailed, speed_mps=np.zeros(n_rows), depth_m=np.full(n_rows, DEPTH_M), altitude_m=np.full(n_rows, ALTITUDE_M)
    )


def tile(side: Side, first_row: int, intensity: NDArray[np.float32]) -> Tile:
    """A tile without overlap whose pixels are `intensity`, 0 for no echo."""
    n_rows = intensity.shape[0]
    return tile_with(
        intensity,
        np.where(intensity > 0.0, VALID, 0).astype(np.uint8),
        side=side,
        index=first_row // 64,
        first_row=first_row,
        row_spacing_m=ROW_M,
        column_spacing_m=COLUMN_M,
        pose=poses(first_row, n_rows),
        first_return_m=ALTITUDE_M,
        ping_number=np.arange(first_row, first_row + n_rows),
    )


def filled_store(n_rows: int = 1024, n_columns: int = 640, seed: int = 1) -> WaterfallStore:
    """A store of speckle on both sides."""
    store, speckle = WaterfallStore(), np.random.default_rng(seed)
    for first_row in range(0, n_rows, 64):
        for side in SIDES:
            store.add(tile(side, first_row, speckle.exponential(1.0, (64, n_columns)).astype(np.float32)))
    return store


def feature(number: int, row: float = 100.0, across_m: float = 20.0, **more: Any) -> dict[str, Any]:
    """A contact of results, abeam of a row of the waterfall."""
    latitude, longitude = position(across_m, row * ROW_M)
    time = np.datetime64(round(1e3 * (START_S + row * ROW_M / SPEED_MPS)), "ms")
    side = "port" if across_m < 0.0 else "starboard"
    properties = {
        "id": f"C{number:05d}",
        "time": f"{time}Z",
        "p_mine": 0.9,
        "class": "cylinder",
        "belief": {"cylinder": 0.9, "unknown": 0.1},
        "length_m": 2.0,
        "width_m": 0.5,
        "height_m": None,
        "n_views": 1,
        "aspects_deg": [90.0],
        "sigma_m": 0.8,
        "side": side,
        "ground_range_m": abs(across_m),
        "reasons": ["highlight_and_shadow"],
        "false_alarms_per_km2": 3.0,
        "called": True,
        "views": [
            {"time": f"{time}Z", "side": side, "ground_range_m": abs(across_m), "p_mine": 0.9, "reasons": ["buried"]}
        ],
        **more,
    }
    return {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": [longitude, latitude]},
        "properties": properties,
    }


def write_results(folder: Path, features: list[dict[str, Any]]) -> Path:
    """A folder of results with these contacts and nothing else."""
    folder.mkdir(exist_ok=True)
    (folder / "snippets").mkdir(exist_ok=True)
    for one in features[:2]:
        (folder / "snippets" / f"{one['properties']['id']}.png").write_bytes(
            encoded(np.zeros((8, 8, 3), dtype=np.uint8), ".png", [])
        )
    (folder / "contacts.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return folder


def shown(folder: Path, store: WaterfallStore | None = None, by: str = "kim") -> ShownMission:
    """The mission of a folder, its waterfall made."""

    def open_nothing(stop: threading.Event) -> OpenedMission | None:
        return None

    store = store or filled_store()
    feed = MissionFeed(store, open_nothing)
    feed.start()
    feed.join()
    mission = ShownMission(folder, feed, by=by, is_live=False)
    mission.refresh()
    return mission
