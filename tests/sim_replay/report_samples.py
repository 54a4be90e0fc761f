"""Made-up missions, contacts and tiles for the tests of the report, and a parser that sees its page as a browser
does."""

from __future__ import annotations

from html.parser import HTMLParser
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import NAN, Contact, Detection, Side, Tile, Waypoint
from auv_mcm.snippet import pack_snippet
from sim_replay.report import MissionRecord, PictureCollector
from tests.auv_mcm.classify import drawn_looks
from tests.make.records import pose_of, tile_with, waypoint_of

ROW_M, COLUMN_M = 0.12, 0.06
START_S = 1_700_000_000.0
VOID = {"meta", "img", "br", "link", "input", "hr"}


class Page(HTMLParser):
    """Collects what a browser would load or show, and checks that elements close in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.sources: list[str] = []
        self.tags: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            elif name in ("href", "xlink:href"):
                (self.sources if tag == "image" else self.links).append(value or "")
            elif name in ("src", "srcset", "data", "poster", "action"):
                self.sources.append(value or "")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & set(self.open):
            self.text += data


def tile(
    index: int,
    side: Side = "port",
    n_rows: int = 64,
    n_columns: int = 200,
    first_row: int | None = None,
    **changes: Any,
) -> Tile:
    first = index * n_rows if first_row is None else first_row
    time_s = START_S + (first + np.arange(n_rows, dtype=np.float64)) * (ROW_M / 2.0)
    values: dict[str, Any] = {
        "side": side,
        "index": index,
        "first_row": first,
        "row_spacing_m": ROW_M,
        "column_spacing_m": COLUMN_M,
        "pose": pose_of(n_rows, time_s=time_s),
        "first_return_m": 0.0,
        "first_return_sigma_m": np.zeros(n_rows),
        "ping_number": first + np.arange(n_rows),
    }
    drawn = np.random.default_rng(index).gamma(2.0, 0.5, (n_rows, n_columns))
    return tile_with(**({"intensity": drawn} | values | changes))


def detection(side: Side = "port", row: float = 30.0, column: float = 100.0, **changes: Any) -> Detection:
    known: dict[str, Any] = {
        "side": side,
        "row": row,
        "column": column,
        "time_s": START_S,
        "ping_number": 30,
        "latitude_deg": 55.0,
        "longitude_deg": 12.0,
        "aspect_deg": 270.0,
        "ground_range_m": 6.0,
        "slant_range_m": 7.0,
        "altitude_m": 4.0,
        "shadow_db": NAN,
        "length_m": 1.5,
        "height_m": NAN,
        "shadow_length_m": NAN,
        "p_mine": 0.8,
        "reasons": ("saturated",),
        "snippet": pack_snippet(np.ones((20, 60))),
        "snippet_row": 4.0,
        "snippet_column": 10.0,
        "row_spacing_m": ROW_M,
        "column_spacing_m": COLUMN_M,
    }
    return drawn_looks.detection(**{**known, **changes})


def contact(name: str = "C0001", p_mine: float = 0.9, **changes: Any) -> Contact:
    known: dict[str, Any] = {
        "time_s": START_S,
        "latitude_deg": 55.0,
        "longitude_deg": 12.0,
        "classification": "truncated_cone",
        "belief": {"truncated_cone": 0.6, "unknown": 0.4},
        "length_m": 1.5,
        "aspects_deg": (270.0,),
        "reasons": ("saturated", "new_reason"),
        "views": (detection(),),
    }
    return drawn_looks.contact(**{**known, "id": name, "p_mine": p_mine, **changes})


def mission(**changes: Any) -> MissionRecord:
    plain = MissionRecord(
        name="Line 7",
        logs=("line7.xtf",),
        start_s=START_S,
        stop_s=START_S + 3723.0,
        duration_s=3723.0,
        track_latitude_deg=np.array([55.0, 55.001, NAN, 55.001, 55.0]),
        track_longitude_deg=np.array([12.0, 12.0, NAN, 12.001, 12.001]),
        distance_m=3200.0,
        covered_km2=0.31,
        wall_s=10.0,
        config_yaml="mission: Line 7\n",
        costs={"read": 1.0, "waterfall": 3.0},
    )
    return msgspec.structs.replace(plain, **changes)


def waypoints() -> list[Waypoint]:
    return [
        waypoint_of(kind, 55.0, 12.0 + step, contact_id="C0001", why="second look")
        for kind, step in (("start", 0.0), ("turn", 0.0003), ("leg_entry", 0.0006), ("leg_exit", 0.001))
    ]


def collected(n_tiles: int = 3) -> PictureCollector:
    pictures = PictureCollector()
    for index in range(n_tiles):
        pictures.add_tile(tile(index, "port"))
        pictures.add_tile(tile(index, "starboard"))
    return pictures


def decoded(jpeg: bytes) -> NDArray[np.int64]:
    picture = cv2.imdecode(np.frombuffer(jpeg, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return np.asarray(picture, dtype=np.int64)
