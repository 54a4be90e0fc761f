"""Locate echoes on Earth: exact push-broom geometry of a side-scan array over a flat bottom.

A line array hears echoes from the plane perpendicular to its axis. An echo at slant range r lies where that plane, the
sphere of radius r and the bottom meet. With a the array's axis and w the downward vertical,

    v = unit(w - (w.a) a)      the steepest direction in the beam plane
    u = v x a  (starboard; port is its opposite)   the level direction in the beam plane
    q = array + sqrt(r^2 - r0^2) u + r0 v

where r0 is the slant range of the first bottom return: on a flat bottom that return comes along v, so r0 is known
without knowing altitude and pitch apart (altitude = r0 cos(array pitch)). Roll turns the beam pattern, not the beam
plane, hence moves an echo only through the lever arm. Vectors are north, east, down at the vehicle unless named
otherwise.
"""

from __future__ import annotations

import functools
import math
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.geometry.geodesy import ecef_to_geodetic, geodetic_to_ecef, local_to_ecef_rotation
from auv_mcm.geometry.pose_track import interpolate_track
from auv_mcm.records import PoseTrack, Side, Tile
from auv_mcm.settings.config import NavigationConfig, SonarConfig

NOMINAL_SOUND_SPEED_MPS: Final = 1500.0
"""For echoes whose ranges are metric already: only the way made during the ping depends on it, millimetres per
percent."""


class EchoGeometry(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold n echoes of one side; every array (n,) float64.

    pose: the vehicle at the transmit instant of each echo's ping. slant_range_m: of the echo; for a point of ground
    range y it is hypot(y, first_return_m). first_return_m: of the bottom below the array, by the same ping.
    """

    side: Side
    pose: PoseTrack
    slant_range_m: NDArray[np.float64]
    first_return_m: NDArray[np.float64]
    sound_speed_mps: NDArray[np.float64]


def tile_echoes(tile: Tile, position: NDArray[np.float64], ground_m: NDArray[np.float64] | float) -> EchoGeometry:
    """Make the echoes of a tile at n places: fractional rows (cut to the tile) and ground ranges, m."""
    first_return_m = np.interp(position, np.arange(len(tile.pose)), tile.first_return_m)
    return EchoGeometry(
        side=tile.side,
        pose=interpolate_track(tile.pose, position),
        slant_range_m=np.hypot(ground_m, first_return_m),
        first_return_m=first_return_m,
        sound_speed_mps=np.full(position.shape, NOMINAL_SOUND_SPEED_MPS),
    )


def locate(
    echoes: EchoGeometry, sonar: SonarConfig
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Compute latitude, longitude in [-180, 180) and height (negative below the surface) of each echo, (n,) each.

    A range shorter than the first return is taken as the point under the array. Without a depth the vehicle is taken to
    be at the surface, without a speed to stand still during the ping; any other NaN gives a NaN position.
    """
    array, echo = _array_and_echo(echoes, sonar)
    pose = echoes.pose
    enu = (array + echo)[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])
    vehicle = geodetic_to_ecef(pose.latitude_deg, pose.longitude_deg, -np.nan_to_num(pose.depth_m, nan=0.0))
    rotation = local_to_ecef_rotation(pose.latitude_deg, pose.longitude_deg)
    return ecef_to_geodetic(vehicle + np.einsum("nij,nj->ni", rotation, enu))


def aspect_deg(echoes: EchoGeometry, sonar: SonarConfig, squint_rad: float = 0.0) -> NDArray[np.float64]:
    """Compute the compass direction from the sonar to each echo, degrees in [0, 360), (n,).

    squint_rad: of a sub-aperture, which heard the echo from so far ahead of abeam.
    """
    _, echo = _array_and_echo(echoes, sonar)
    clockwise_deg = math.degrees(squint_rad) * (1.0 if echoes.side == "port" else -1.0)
    direction = np.mod(np.rad2deg(np.arctan2(echo[:, 1], echo[:, 0])) + clockwise_deg, 360.0)
    return np.where(direction >= 360.0, 0.0, direction)  # mod rounds tiny negative angles up to 360


def position_covariance(
    echoes: EchoGeometry, sonar: SonarConfig, navigation: NavigationConfig, first_return_sigma_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the east/north covariance of each echo's position, (n, 2, 2), m^2.

    First-order propagation of independent errors of the first return (1-sigma, (n,)), heading, pitch and slant range
    (range error = range times relative sound speed error), added to the fix's own. Heading errs as its sensor does, and
    by what a course in its place adds. Each derivative is the secant over plus and minus one sigma: that stays finite
    towards nadir, where the tangent of sqrt(r^2 - r0^2) does not.
    """
    pose = echoes.pose
    heading_sigma = np.hypot(np.deg2rad(navigation.heading_sigma_deg), pose.heading_sigma_rad)
    pitch_sigma = np.deg2rad(navigation.pitch_sigma_deg)
    range_sigma = echoes.slant_range_m * navigation.sound_speed_sigma_mps / echoes.sound_speed_mps

    def moved(sign: float) -> list[EchoGeometry]:
        replace = msgspec.structs.replace
        return [
            replace(echoes, first_return_m=np.maximum(echoes.first_return_m + sign * first_return_sigma_m, 0.0)),
            replace(echoes, pose=replace(pose, heading_rad=pose.heading_rad + sign * heading_sigma)),
            replace(echoes, pose=replace(pose, pitch_rad=pose.pitch_rad + sign * pitch_sigma)),
            replace(echoes, slant_range_m=echoes.slant_range_m + sign * range_sigma),
        ]

    covariance = np.zeros((len(pose), 2, 2))
    covariance[:, 0, 0] = covariance[:, 1, 1] = navigation.position_sigma_m**2
    for above, below in zip(moved(1.0), moved(-1.0), strict=True):
        error = 0.5 * (np.add(*_array_and_echo(above, sonar)) - np.add(*_array_and_echo(below, sonar)))
        east_north = error[:, [1, 0]]
        covariance += east_north[:, :, np.newaxis] * east_north[:, np.newaxis, :]
    return covariance


def _array_and_echo(echoes: EchoGeometry, sonar: SonarConfig) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute the array from the vehicle as the echo forms, and the echo from the array.

    (n, 3) north, east, down each, m.
    """
    pose = echoes.pose
    slant_range, first_return = echoes.slant_range_m, echoes.first_return_m
    attitude = _attitude(pose.heading_rad, pose.pitch_rad, pose.roll_rad)
    axis = attitude @ _forward(sonar.heading_offset_deg, sonar.pitch_offset_deg)
    # Transmission and reception are 2 r / c apart: the echo is as from half way between the two places.
    advance = np.nan_to_num(pose.speed_mps, nan=0.0) * slant_range / echoes.sound_speed_mps
    array = attitude @ np.array(sonar.lever_arm_m)
    array[:, 0] += advance * np.cos(pose.heading_rad)
    array[:, 1] += advance * np.sin(pose.heading_rad)

    steepest = np.array([0.0, 0.0, 1.0]) - axis[:, 2:] * axis
    steepest /= np.linalg.norm(steepest, axis=1, keepdims=True)
    level = np.cross(steepest, axis) if echoes.side == "starboard" else np.cross(axis, steepest)
    # The factored form does not cancel near the first return.
    across = np.sqrt(np.maximum((slant_range - first_return) * (slant_range + first_return), 0.0))
    return array, across[:, np.newaxis] * level + first_return[:, np.newaxis] * steepest


@functools.lru_cache(maxsize=8)
def _forward(heading_offset_deg: float, pitch_offset_deg: float) -> NDArray[np.float64]:
    """Compute the unit vector along the array, (3,) forward, starboard, down at the vehicle; read-only."""
    offsets = np.deg2rad(np.array([[heading_offset_deg, pitch_offset_deg]]))
    forward = _attitude(offsets[:, 0], offsets[:, 1], np.zeros(1))[0, :, 0]
    forward.flags.writeable = False
    return forward


def _attitude(
    heading_rad: NDArray[np.float64], pitch_rad: NDArray[np.float64], roll_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute rotations (n, 3, 3) from forward, starboard, down to north, east, down.

    Heading first, then pitch, then roll.
    """
    sin_h, cos_h = np.sin(heading_rad), np.cos(heading_rad)
    sin_p, cos_p = np.sin(pitch_rad), np.cos(pitch_rad)
    sin_r, cos_r = np.sin(roll_rad), np.cos(roll_rad)
    rotation = np.empty((len(heading_rad), 3, 3))
    rotation[:, 0, 0], rotation[:, 1, 0], rotation[:, 2, 0] = cos_h * cos_p, sin_h * cos_p, -sin_p
    rotation[:, 0, 1] = cos_h * sin_p * sin_r - sin_h * cos_r
    rotation[:, 1, 1] = sin_h * sin_p * sin_r + cos_h * cos_r
    rotation[:, 0, 2] = cos_h * sin_p * cos_r + sin_h * sin_r
    rotation[:, 1, 2] = sin_h * sin_p * cos_r - cos_h * sin_r
    rotation[:, 2, 1], rotation[:, 2, 2] = cos_p * sin_r, cos_p * cos_r
    return rotation
