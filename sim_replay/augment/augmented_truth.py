"""Build truth.json of an augmented log: embedded objects and their views, in the form that `auv-mcm score` reads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import SIDES
from sim_replay.augment.embed import Embedded, EmbeddedView
from sim_replay.augment.track import SIGN, PingTrack
from sim_replay.simulator.objects import rise_m
from sim_replay.simulator.truth import CELL_M

_STEP_M: Final = 0.5 * CELL_M


def augmented_truth_of(
    objects: Sequence[Embedded], track: PingTrack, background: str, seed: int, seabed: str | None = None
) -> dict[str, Any]:
    """Return the area seen and every object.

    What other objects the log shows is not in it.

    Parameters
    ----------
    background
        Name of the log, by which training and test data are kept apart.
    seabed
        Of the whole log, where it is known.
    """
    return {
        "version": 1,
        "background": background,
        "seed": seed,
        "area_km2": swept_area_m2(track) / 1e6,
        "objects": [_object(one, background, seabed) for one in objects],
    }


def swept_area_m2(track: PingTrack) -> float:
    """Return the area of sea floor shown well enough to put objects on it, each square metre once."""
    way_m = np.floor((track.along_m - track.along_m[0]) / _STEP_M)
    sampled = np.flatnonzero(np.diff(way_m, prepend=-1.0) > 0.0)
    codes: list[NDArray[np.int64]] = []
    for ping in sampled[[not track.why[k] for k in sampled]].tolist():
        for row, side in enumerate(SIDES):
            nearest, farthest = float(track.nearest_m[row, ping]), float(track.farthest_m[row, ping])
            if not nearest < farthest:
                continue
            across = SIGN[side] * np.arange(nearest, farthest, _STEP_M)
            heading = float(track.heading_rad[ping])
            north = np.floor((track.north_m[ping] - across * math.sin(heading)) / CELL_M).astype(np.int64)
            east = np.floor((track.east_m[ping] + across * math.cos(heading)) / CELL_M).astype(np.int64)
            codes.append(np.unique((north << 32) + east))
    return np.unique(np.concatenate(codes)).size * CELL_M * CELL_M if codes else 0.0


def _object(one: Embedded, background: str, seabed: str | None) -> dict[str, Any]:
    scene_object, first = one.scene_object, one.looks[0]
    facts: dict[str, Any] = {
        "kind": scene_object.kind,
        "lat": one.latitude_deg,
        "lon": one.longitude_deg,
        "is_target": scene_object.is_target,
        "azimuth_deg": math.degrees(scene_object.azimuth_rad) % 360.0,
        "length_m": scene_object.length_m,
        "width_m": scene_object.width_m,
        "height_m": scene_object.height_m,
        "rise_m": rise_m(scene_object),
        "burial_m": scene_object.burial_m,
        "tilt_deg": math.degrees(scene_object.tilt_rad),
        "side": first.side,
        "ping": first.ping,
        "ground_range_m": first.ground_range_m,
        "visible_fraction": first.visible_fraction,
        "contrast_db": first.contrast_db,
        "background": background,
        "looks": [_look(look) for look in one.looks],
    }
    return facts if seabed is None else {**facts, "seabed": seabed}


def _look(look: EmbeddedView) -> dict[str, Any]:
    moment = datetime.fromtimestamp(look.time_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    return {
        "side": look.side,
        "ping": look.ping,
        "ground_range_m": look.ground_range_m,
        "time": moment,
        "visible_fraction": look.visible_fraction,
        "contrast_db": look.contrast_db,
    }
