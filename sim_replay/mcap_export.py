"""Write a mission as an MCAP file with the messages of Foxglove: track, waterfall, contacts and maps.

Each message is a protocol buffer of the published schemas (github.com/foxglove/foxglove-sdk), which the file carries.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import cv2
import numpy as np

from auv_mcm.contacts.contact_picture import coloured_levels, display_levels, encoded
from auv_mcm.records import VALID, Side, Tile
from sim_replay.mosaic_files import replaced_file
from sim_replay.verdict_layers import MISSED, is_likely, verdict_words
from sim_replay.view.mission_files import time_s as utc_s

if TYPE_CHECKING:
    from google.protobuf.timestamp_pb2 import Timestamp

_FIX_S: Final = 1.0  # s between two positions of the track
_JPEG_QUALITY: Final = 85  # of the waterfall
_RING_M: Final = 2.5  # m: radius of the ring around a contact, beyond the largest mine
_NS: Final = 1_000_000_000  # nanoseconds per second
_ROUNDED_S: Final = 5e-4  # s: times of views are written in milliseconds
_FRAME: Final = "wgs84"

Feature = Mapping[str, Any]


class _View(NamedTuple):
    """Hold one view of a contact: where it is in the waterfall, and what to write beside it."""

    side: Side
    time_s: float
    ground_range_m: float
    text: str
    mine_like: bool


def write_mcap(path: Path, tiles: Iterable[Tile], layers: Mapping[str, Sequence[Feature]]) -> None:
    """Write the tiles with the contacts seen in each, the track, and each layer as a map at the beginning.

    Topics: `/vehicle/fix` (LocationFix), `/sonar/SIDE` (CompressedImage, as seen from above travelling up),
    `/sonar/SIDE/contacts` (ImageAnnotations), `/map/LAYER` (GeoJSON). Times are those of the pings.

    Raises OSError.
    """
    from mcap_protobuf.writer import Writer  # bench extra

    views = [*_views(layers.get("contacts", ())), *_missed_views(layers.get(MISSED, ()))]
    last_fix_s = -math.inf
    side: Side | None = None
    with replaced_file(path) as temporary, open(temporary, "wb") as file, Writer(file) as writer:
        for tile in tiles:
            timed = np.flatnonzero(np.isfinite(tile.pose.time_s[tile.core_start : tile.core_stop])) + tile.core_start
            if not len(timed):
                continue
            if side is None:
                side = tile.side
                _write_maps(writer, layers, float(tile.pose.time_s[timed[0]]))
            if tile.side == side:  # the other one has the same track
                last_fix_s = _write_fixes(writer, tile, timed.tolist(), last_fix_s)
            _write_picture(writer, tile, float(tile.pose.time_s[timed[-1]]), views)


def _write_maps(writer: Any, layers: Mapping[str, Sequence[Feature]], time_s: float) -> None:
    from foxglove_schemas_protobuf.GeoJSON_pb2 import GeoJSON

    for name, features in layers.items():
        placed = [feature for feature in features if feature["geometry"]]
        if placed:
            text = json.dumps({"type": "FeatureCollection", "features": placed}, ensure_ascii=False)
            _write(writer, f"/map/{name}", GeoJSON(geojson=text), time_s)


def _write_fixes(writer: Any, tile: Tile, rows: Sequence[int], last_s: float) -> float:
    """Write a position a second, also behind a clock that was set back; return when the last one was."""
    from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

    pose = tile.pose
    for row in rows:
        time_s = float(pose.time_s[row])
        latitude_deg, longitude_deg = float(pose.latitude_deg[row]), float(pose.longitude_deg[row])
        is_known = math.isfinite(latitude_deg) and math.isfinite(longitude_deg) and not pose.stale[row]
        if abs(time_s - last_s) < _FIX_S or not is_known:
            continue
        last_s = time_s
        fix = LocationFix(
            timestamp=_stamp(time_s),
            frame_id=_FRAME,
            latitude=latitude_deg,
            longitude=longitude_deg,
            altitude=-float(pose.depth_m[row]),  # NaN where unknown, as in ROS's NavSatFix: without it 0 is read
            position_covariance_type=LocationFix.UNKNOWN,
        )
        _write(writer, "/vehicle/fix", fix, time_s)
    return last_s


def _write_picture(writer: Any, tile: Tile, time_s: float, views: Sequence[_View]) -> None:
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    core = slice(tile.core_start, tile.core_stop)
    level = display_levels(tile.intensity[core])
    level[(tile.mask[core] & VALID) == 0] = 0
    pixel_m = max(tile.row_spacing_m, tile.column_spacing_m)
    size = tuple(
        max(1, round(n * spacing_m / pixel_m))
        for n, spacing_m in ((level.shape[1], tile.column_spacing_m), (level.shape[0], tile.row_spacing_m))
    )
    picture = cv2.resize(coloured_levels(level), size, interpolation=cv2.INTER_AREA)[::-1]
    picture = np.ascontiguousarray(picture[:, ::-1] if tile.side == "port" else picture)
    jpeg = encoded(picture.astype(np.uint8), ".jpg", [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    image = CompressedImage(timestamp=_stamp(time_s), frame_id=tile.side, data=jpeg, format="jpeg")
    _write(writer, f"/sonar/{tile.side}", image, time_s)
    _write(writer, f"/sonar/{tile.side}/contacts", _annotations(tile, time_s, views, pixel_m, size), time_s)


def _annotations(tile: Tile, time_s: float, views: Sequence[_View], pixel_m: float, size: tuple[int, ...]) -> Any:
    """Draw a ring and a name around each contact seen in the tile; pixels as of the picture."""
    from foxglove_schemas_protobuf.CircleAnnotation_pb2 import CircleAnnotation
    from foxglove_schemas_protobuf.Color_pb2 import Color
    from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
    from foxglove_schemas_protobuf.Point2_pb2 import Point2
    from foxglove_schemas_protobuf.TextAnnotation_pb2 import TextAnnotation

    times_s = tile.pose.time_s[tile.core_start : tile.core_stop + 1]  # places lie between rows, up to the next tile's
    ends_s = _ROUNDED_S if tile.core_stop >= len(tile.pose) else -_ROUNDED_S
    found = ImageAnnotations(timestamp=_stamp(time_s))
    rising = bool(np.isfinite(times_s).all() and (np.diff(times_s) >= 0.0).all())
    for view in views:
        if view.side != tile.side or not rising:
            continue
        if not times_s[0] - _ROUNDED_S <= view.time_s < times_s[-1] + ends_s:
            continue
        row_m = (float(np.interp(view.time_s, times_s, np.arange(len(times_s)))) + 0.5) * tile.row_spacing_m
        right, down = view.ground_range_m / pixel_m, size[1] - row_m / pixel_m
        place = Point2(x=size[0] - right if tile.side == "port" else right, y=down)
        colour = Color(r=1.0, g=0.25, b=0.4, a=1.0) if view.mine_like else Color(r=0.7, g=0.8, b=0.9, a=1.0)
        stamp = _stamp(view.time_s)
        ring = CircleAnnotation(
            timestamp=stamp, position=place, diameter=2.0 * _RING_M / pixel_m, thickness=2.0, outline_color=colour
        )
        found.circles.append(ring)
        found.texts.append(
            TextAnnotation(timestamp=stamp, position=place, text=view.text, font_size=14.0, text_color=colour)
        )
    return found


def _views(contacts: Iterable[Feature]) -> list[_View]:
    views = []
    for contact in contacts:
        properties = contact["properties"]
        p_mine = properties["p_mine"] or 0.0
        for view in properties["views"]:
            if view["time"] is not None and view["ground_range_m"] is not None:
                time_s = utc_s(view["time"])
                text = " ".join(filter(None, (f"{properties['id']} {p_mine:.4f}", verdict_words(properties))))
                views.append(_View(view["side"], time_s, view["ground_range_m"], text, is_likely(contact)))
    return views


def _missed_views(missed: Iterable[Feature]) -> list[_View]:
    """List where people drew what the chain has no contact of."""
    views = []
    for one in missed:
        properties = one["properties"]
        if properties["time"] and properties["side"] and properties["ground_range_m"] is not None:
            time_s = utc_s(properties["time"])
            text = f"{properties['id']} missed, {verdict_words(properties)}"
            views.append(_View(properties["side"], time_s, properties["ground_range_m"], text, mine_like=True))
    return views


def _stamp(time_s: float) -> Timestamp:
    from google.protobuf.timestamp_pb2 import Timestamp

    seconds, nanoseconds = divmod(round(time_s * _NS), _NS)
    return Timestamp(seconds=seconds, nanos=nanoseconds)


def _write(writer: Any, topic: str, message: Any, time_s: float) -> None:
    time_ns = max(round(time_s * _NS), 0)
    writer.write_message(topic, message, log_time=time_ns, publish_time=time_ns)
