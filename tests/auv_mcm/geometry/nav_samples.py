"""Make navigation samples along a plain track, and read back where a buffer puts them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.navigation import NavBuffer
from auv_mcm.records import NAN, NavSample, PoseTrack
from auv_mcm.settings.config import NavigationConfig

START_S = 1_700_000_000.0
FRAME = LocalFrame(latitude_deg=43.7, longitude_deg=10.3)
HEADING_RAD = 1e-9  # a compass never reads exactly 0 for long: that is a field which was never filled
POSE_FIELDS = tuple(name for name in PoseTrack.__struct_fields__ if name != "time_s")


def filled(samples: Iterable[NavSample], config: NavigationConfig | None = None) -> NavBuffer:
    buffer = NavBuffer(config or NavigationConfig())
    for sample in samples:
        buffer.add(sample)
    return buffer


def at(buffer: NavBuffer, *seconds: float) -> PoseTrack:
    return buffer.interpolate(START_S + np.array(seconds))


def here(
    seconds: float, east: float = 0.0, north: float = 0.0, frame: LocalFrame = FRAME, **values: float
) -> NavSample:
    """A full sample `seconds` after the start at a local position."""
    latitude, longitude, _ = frame.to_geodetic(np.array([east, north, 0.0]))
    known: dict[str, Any] = {
        "heading_rad": HEADING_RAD,
        "pitch_rad": 0.0,
        "roll_rad": 0.0,
        "depth_m": 5.0,
        "altitude_m": 6.0,
        "speed_mps": 1.0,
        **values,
    }
    return NavSample(time_s=START_S + seconds, latitude_deg=float(latitude), longitude_deg=float(longitude), **known)


def without(sample: NavSample, *names: str) -> NavSample:
    return msgspec.structs.replace(sample, **dict.fromkeys(names, NAN))


def only(seconds: float, **values: Any) -> NavSample:
    return NavSample(time_s=START_S + seconds, **values)


def east_north(track: PoseTrack, frame: LocalFrame = FRAME) -> NDArray[np.float64]:
    return frame.to_enu(track.latitude_deg, track.longitude_deg, 0.0)[:, :2]


def assert_same(a: PoseTrack, b: PoseTrack) -> None:
    for name in POSE_FIELDS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
