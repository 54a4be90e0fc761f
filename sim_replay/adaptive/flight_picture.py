"""Draw one mission: tracks over the true sea floor with its mines, and the clearance map at the end."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.clearance.clearance_picture import KIND_COLOURS, clearance_picture
from auv_mcm.contacts.contact_picture import encoded
from sim_replay.adaptive.flight import AdaptiveFlight
from sim_replay.adaptive.order import Order
from sim_replay.fitting.seabed.seabed_missions import KIND_OF
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.sea import Sea

Bytes = NDArray[np.uint8]

_PER_M: Final = 4.0  # pixels per metre
_AROUND_M: Final = 40.0  # m shown around the square
_STEP_M: Final = 0.5  # m between the places whose sea floor is drawn
_INK: Final = (60, 50, 40)  # blue, green, red
_TRACK: Final = (30, 30, 200)  # blue, green, red


def mission_png(scene: Scene, order: Order, flights: dict[str, AdaptiveFlight]) -> bytes:
    """Return a PNG with a row per flight, by title.

    Track over the true sea floor, then clearance and sea floor as mapped.
    """
    floor = _floor(scene, order)
    return encoded(np.vstack([_row(title, floor, order, flight) for title, flight in flights.items()]), ".png", [])


def _floor(scene: Scene, order: Order) -> Bytes:
    """Draw the true kinds of sea floor, with the area's outline and all mines."""
    sea = Sea(scene)
    at = np.arange(-_AROUND_M, order.side_m + _AROUND_M, _STEP_M) + 0.5 * _STEP_M
    covers = np.array([KIND_COLOURS[KIND_OF[cover.type]] for cover in sea.world.covers], dtype=np.uint8)
    picture = covers[sea.world.seabed_at(*np.meshgrid(at, at[::-1]))]
    size = round(len(at) * _STEP_M * _PER_M)
    picture = np.asarray(cv2.resize(picture, (size, size), interpolation=cv2.INTER_NEAREST), dtype=np.uint8)
    corners = _pixels(
        order, np.array([(0.0, 0.0), (order.side_m, 0.0), (order.side_m, order.side_m), (0.0, order.side_m)])
    )
    cv2.polylines(picture, [corners], isClosed=True, color=_INK, thickness=2)
    for scene_object in sea.objects:
        if scene_object.is_target:
            (place,) = _pixels(order, np.array([(scene_object.east_m, scene_object.north_m)]))
            cv2.circle(picture, (int(place[0]), int(place[1])), 5, (0, 0, 0), 2)
    return picture


def _row(title: str, floor: Bytes, order: Order, flight: AdaptiveFlight) -> Bytes:
    picture = floor.copy()
    cv2.polylines(
        picture, [_pixels(order, flight.track)], isClosed=False, color=_TRACK, thickness=1, lineType=cv2.LINE_AA
    )
    words = f"{title}: {flight.way_m:.0f} m, clearance {flight.ground.p_detected.mean():.2f}"
    cv2.putText(picture, words, (12, 26), cv2.FONT_HERSHEY_SIMPLEX, 0.7, _INK, 2, cv2.LINE_AA)
    maps = clearance_picture(flight.ground)
    height = max(len(picture), len(maps))
    return np.hstack([_padded(picture, height), _padded(maps, height)])


def _padded(picture: Bytes, height: int) -> Bytes:
    return np.pad(picture, ((0, height - len(picture)), (0, 0), (0, 0)), constant_values=255)


def _pixels(order: Order, places: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return (n, 2) pixels of (n, 2) places east and north."""
    column = (places[:, 0] + _AROUND_M) * _PER_M
    row = (order.side_m + _AROUND_M - places[:, 1]) * _PER_M
    return np.rint(np.stack([column, row], axis=1)).astype(np.int32)
