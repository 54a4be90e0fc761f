"""Trace the rays of pings: their starts, their directions, and the patches of the sea floor they cross."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_replay.simulator.render import Lines
from sim_replay.simulator.scene import Sonar
from sim_replay.simulator.vehicle import SonarPose
from sim_replay.simulator.world import PATCH

_STRIDE: Final = 32  # nodes between those whose surroundings are looked up when patches are counted
_OUTERMOST: Final = 0.9  # beam widths that the outermost rays stand off the middle


class Fan(NamedTuple):
    """Hold rays of a block of pings in metres: places (n,) float64 east and north of node 0, and steps per node."""

    east_m: NDArray[np.float64]
    north_m: NDArray[np.float64]
    step_east_m: NDArray[np.float64]
    step_north_m: NDArray[np.float64]
    elevation_m: NDArray[np.float64]
    slant_factor: NDArray[np.float64]
    axis_rad: NDArray[np.float64]
    weight: NDArray[np.float64]
    ping: NDArray[np.int64]
    n_nodes: int


def beam_rays(sonar: Sonar) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the angles (rad) of rays that stand for the horizontal beam, and their shares, which sum to 1.

    The beam is a Gaussian of the beam's width.
    """
    n = sonar.beam_lines
    off = np.linspace(-_OUTERMOST, _OUTERMOST, n) if n > 1 else np.zeros(1)
    share = np.exp(-4.0 * math.log(2.0) * off * off)
    return off * math.radians(sonar.beam_width_deg), share / share.sum()


def fan(
    poses: Sequence[SonarPose], floor_m: NDArray[np.float64], sonar: Sonar, datum_depth_m: float, cell_m: float
) -> Fan:
    """Return rays of both sides of all poses: pose i adds to rows 2 i for port and 2 i + 1 for starboard.

    floor_m: (n_poses,) height of the floor below the sonar above the datum. While echoes come in the vehicle travels
    on; range r is seen from where it is r / c after transmission, midway between transmitting and receiving. Pitch
    tilts the plane that a side looks in; on a level floor the strip within the beam widens by 1 / cos(pitch).
    """
    angle, share = beam_rays(sonar)
    columns = {name: np.array([getattr(pose, name) for pose in poses])[:, None, None] for name in SonarPose._fields}
    heading, pitch = columns["heading_rad"], columns["pitch_rad"]
    side = np.array([-1.0, 1.0])[None, :, None]
    elevation = datum_depth_m - columns["depth_m"]
    altitude = elevation - floor_m[:, None, None]
    turned = heading + side * (0.5 * math.pi - angle[None, None, :])
    ahead_east, ahead_north = np.sin(heading), np.cos(heading)
    # Slant range against ground range as a straight line, exact where it is an altitude and at the end.
    farthest = np.sqrt(np.maximum(sonar.range_m**2 - altitude**2, altitude**2 + 1.0))
    per_metre = (np.hypot(farthest, altitude) - math.sqrt(2.0) * altitude) / (farthest - altitude)
    at_once = math.sqrt(2.0) * altitude - per_metre * altitude
    drift = columns["speed_mps"] / sonar.sound_speed_mps
    drift_east, drift_north = drift * np.sin(columns["course_rad"]), drift * np.cos(columns["course_rad"])
    tilted = altitude * np.tan(pitch)

    shape = np.broadcast_shapes(turned.shape, (len(poses), 2, len(angle)))

    def flat(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.broadcast_to(values, shape).ravel()

    return Fan(
        east_m=flat(columns["east_m"] + tilted * ahead_east + at_once * drift_east),
        north_m=flat(columns["north_m"] + tilted * ahead_north + at_once * drift_north),
        step_east_m=flat((np.sin(turned) + per_metre * drift_east) * cell_m),
        step_north_m=flat((np.cos(turned) + per_metre * drift_north) * cell_m),
        elevation_m=flat(elevation),
        slant_factor=flat(1.0 / np.cos(pitch)),
        axis_rad=flat(math.radians(sonar.tilt_deg) + side * columns["roll_rad"]),
        weight=flat(share[None, None, :] / np.cos(pitch)),
        ping=flat(np.arange(2 * len(poses), dtype=np.float64).reshape(len(poses), 2, 1)).astype(np.int64),
        n_nodes=math.ceil(sonar.range_m / cell_m) + 2,
    )


def crossed(rays: Fan, cell_m: float) -> tuple[NDArray[np.bool_], int, int]:
    """Return the patches that rays may cross, (n_patch_rows, n_patch_columns), and the row and column of the first."""
    node = np.append(np.arange(0, rays.n_nodes, _STRIDE), rays.n_nodes - 1).astype(np.float64)
    north = (rays.north_m[:, None] + node * rays.step_north_m[:, None]) / cell_m
    east = (rays.east_m[:, None] + node * rays.step_east_m[:, None]) / cell_m
    margin = _STRIDE + 1
    low_row, low_column = math.floor((north.min() - margin) / PATCH), math.floor((east.min() - margin) / PATCH)
    high_row, high_column = math.floor((north.max() + margin) / PATCH), math.floor((east.max() + margin) / PATCH)
    needed = np.zeros((high_row - low_row + 1, high_column - low_column + 1), dtype=np.bool_)
    for by_north in (-margin, margin):
        row = np.floor((north + by_north) / PATCH).astype(np.int64) - low_row
        for by_east in (-margin, margin):
            needed[row, np.floor((east + by_east) / PATCH).astype(np.int64) - low_column] = True
    return needed, low_row, low_column


def lines(rays: Fan, cell_m: float) -> Lines:
    """Return the rays in cells."""
    return Lines(
        north_cells=rays.north_m / cell_m,
        east_cells=rays.east_m / cell_m,
        step_north=rays.step_north_m / cell_m,
        step_east=rays.step_east_m / cell_m,
        elevation_m=rays.elevation_m,
        slant_factor=rays.slant_factor,
        axis_cos=np.cos(rays.axis_rad),
        axis_sin=np.sin(rays.axis_rad),
        weight=rays.weight,
        ping=rays.ping,
    )
