"""Add navigation errors to the sonar's true poses."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from auv_mcm.geometry.geodesy import ecef_to_geodetic, geodetic_to_ecef
from auv_mcm.records import NavSample
from sim_replay.simulator.gauss_markov import GaussMarkov
from sim_replay.simulator.plan import local_frame
from sim_replay.simulator.scene import NavigationError, Origin
from sim_replay.simulator.vehicle import SonarPose

_STREAM: Final = 0x4E415645  # keeps these random numbers apart from others of the same seed
_BLOCK: Final = 512  # random numbers drawn at once
_NOISES: Final = 4  # heading, pitch, roll, altitude


class NavigationModel:
    """Simulate a navigation system whose errors are drawn once per mission.

    Position: a Gauss-Markov error to the east and another to the north, plus a drift in one direction, drawn at the
    start, that grows with the distance travelled: what dead reckoning with a wrong heading or log builds up on a
    straight way. Heading, altitude and speed carry a bias; attitude and altitude carry noise that is new in every
    sample. Depth is exact.
    """

    def __init__(self, error: NavigationError, origin: Origin, seed: int) -> None:
        frame = local_frame(origin)
        self._error = error
        self._origin_m = geodetic_to_ecef(frame.latitude_deg, frame.longitude_deg, frame.height_m)
        self._rotation = frame.rotation()
        once, east, north, noise = (
            np.random.Generator(np.random.PCG64(s)) for s in np.random.SeedSequence([seed, _STREAM]).spawn(4)
        )
        drift_rad = once.uniform(0.0, 2.0 * math.pi)
        heading, altitude, speed = once.standard_normal(3).tolist()
        self._drift = 0.01 * error.drift_percent * math.sin(drift_rad), 0.01 * error.drift_percent * math.cos(drift_rad)
        self._heading_bias_rad = math.radians(error.heading_bias_sigma_deg) * heading
        self._altitude_factor = 1.0 + 0.01 * error.altitude_bias_percent * altitude
        self._speed_factor = 1.0 + 0.01 * error.speed_bias_percent * speed
        self._east = GaussMarkov(error.position_sigma_m, error.position_period_s, east)
        self._north = GaussMarkov(error.position_sigma_m, error.position_period_s, north)
        self._random = noise
        self._noise: list[list[float]] = []
        self._start_s = math.nan
        self._last: SonarPose | None = None
        self._travelled_m = 0.0

    def reported(self, pose: SonarPose, altitude_m: float) -> NavSample:
        """Return the sample of a pose; call in order of time. Heading is true and in [0, 2 pi); no altitude is below 0.

        altitude_m: the true height over the floor.
        """
        if self._last is None:
            self._start_s = pose.time_s
        else:
            self._travelled_m += 0.5 * (self._last.speed_mps + pose.speed_mps) * (pose.time_s - self._last.time_s)
        self._last = pose
        since = pose.time_s - self._start_s
        reported_east = pose.east_m + self._east.at(since)[0] + self._drift[0] * self._travelled_m
        reported_north = pose.north_m + self._north.at(since)[0] + self._drift[1] * self._travelled_m
        latitude, longitude, heading = self._on_the_globe(pose, reported_east, reported_north)
        if not self._noise:
            self._noise = self._random.standard_normal((_BLOCK, _NOISES)).tolist()
        heading_noise, pitch_noise, roll_noise, altitude_noise = self._noise.pop()
        noise_rad = math.radians(self._error.attitude_noise_deg)
        return NavSample(
            time_s=pose.time_s,
            latitude_deg=latitude,
            longitude_deg=longitude,
            heading_rad=_wrapped(heading + self._heading_bias_rad + noise_rad * heading_noise),
            pitch_rad=pose.pitch_rad + noise_rad * pitch_noise,
            roll_rad=pose.roll_rad + noise_rad * roll_noise,
            depth_m=pose.depth_m,
            altitude_m=max(0.0, altitude_m * self._altitude_factor + self._error.altitude_noise_m * altitude_noise),
            speed_mps=pose.speed_mps * self._speed_factor,
        )

    def _on_the_globe(
        self, pose: SonarPose, reported_east_m: float, reported_north_m: float
    ) -> tuple[float, float, float]:
        """Return the reported latitude and longitude, and the heading against the true north at the sonar.

        Meridians converge, so that true north differs from the plane's.
        """
        sine, cosine = math.sin(pose.heading_rad), math.cos(pose.heading_rad)
        plane = np.array(
            [[reported_east_m, reported_north_m, 0.0], [pose.east_m, pose.north_m, 0.0], [sine, cosine, 0.0]]
        )
        reported, true, ahead = plane @ self._rotation.T
        latitudes_deg, longitudes_deg, _ = ecef_to_geodetic(np.stack((reported, true)) + self._origin_m)
        latitude, longitude = math.radians(latitudes_deg[1]), math.radians(longitudes_deg[1])
        x, y, z = ahead.tolist()
        away = x * math.cos(longitude) + y * math.sin(longitude)  # from the Earth's axis
        to_east = y * math.cos(longitude) - x * math.sin(longitude)
        to_north = z * math.cos(latitude) - away * math.sin(latitude)
        return float(latitudes_deg[0]), float(longitudes_deg[0]), math.atan2(to_east, to_north)


def _wrapped(angle_rad: float) -> float:
    """Wrap a direction into [0, 2 pi)."""
    wrapped = angle_rad % (2.0 * math.pi)
    return wrapped if wrapped < 2.0 * math.pi else 0.0  # a hair below zero rounds to the full circle
