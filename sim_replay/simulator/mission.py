"""Simulate a mission: a vehicle flies over a sea, and its sonar and navigation report ping by ping."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any, Final

import msgspec

from auv_mcm.records import NavSample, Ping
from sim_replay.simulator.aperture import Aperture
from sim_replay.simulator.faults import with_faults
from sim_replay.simulator.navigation_error import NavigationModel
from sim_replay.simulator.plan import Leg, planned_legs
from sim_replay.simulator.scene import Scene
from sim_replay.simulator.sea import Sea
from sim_replay.simulator.truth import TruthLog, truth_of
from sim_replay.simulator.vehicle import SonarPose, Vehicle

_BLOCK: Final = 32  # pings rendered at a time
_TURN_S: Final = 60.0  # between the image strips of legs


class Mission:
    """Fly once through a scene.

    `events` may be fed to a pipeline or a port as it is; `follow` changes the course on the way, and the vehicle sees
    the same world from there. What comes out depends on the scene, its seed and the plans alone, not on block_pings or
    threads; a new plan takes effect after the pings of the block under way, or after the leg with a synthetic aperture,
    whose image is made of whole legs. Raises UsageError for a scene that cannot be.
    """

    def __init__(self, scene: Scene, *, threads: int = 1, block_pings: int = _BLOCK) -> None:
        self.scene: Final = scene
        self.sea: Final = Sea(scene, threads=threads)
        legs = planned_legs(scene.track.plan)
        self.vehicle: Final = Vehicle(scene.track, legs, scene.seed, self._depth_of_floor)
        self._legs_ahead = list(legs)  # of a synthetic aperture, which does not fly the vehicle
        self._navigation = NavigationModel(scene.navigation_error, scene.origin, scene.seed)
        self._log = TruthLog(self.sea)
        self._block = block_pings

    def events(self) -> Iterator[NavSample | Ping]:
        """Yield each ping after its navigation sample, as reported to the payload, until the plan is done."""
        heard = self._pings() if self.scene.sonar.synthetic_aperture is None else self._lines()
        return with_faults(heard, self.scene.faults, self.sea.recorder)

    def follow(self, legs: Sequence[Leg]) -> None:
        """Replace the rest of the plan."""
        self.vehicle.follow(legs)
        self._legs_ahead = list(legs)

    def truth(self) -> dict[str, Any]:
        """Return the truth about all floor passed so far, in the form of truth.json."""
        return truth_of(self.sea, self._log)

    def _pings(self) -> Iterator[NavSample | Ping]:
        poses = self.vehicle.poses(self.scene.sonar.ping_rate_hz)
        number = 0
        while block := list(islice(poses, self._block)):
            reported = self._reported(block)
            for sample, ping in zip(
                reported, self.sea.sound(block, number, [sample.altitude_m for sample in reported]), strict=True
            ):
                yield sample
                yield ping
            number += len(block)

    def _lines(self) -> Iterator[NavSample | Ping]:
        aperture = Aperture(self.sea)
        start_s, number, n_legs = self.scene.track.start_time_s, 0, 0
        while self._legs_ahead:
            leg = self._legs_ahead.pop(0)
            lines = aperture.lines(aperture.strip(leg, n_legs), start_s, number)
            while block := list(islice(lines, self._block)):
                for sample, (_, ping) in zip(self._reported([pose for pose, _ in block]), block, strict=True):
                    yield sample
                    yield msgspec.structs.replace(ping, altitude_m=sample.altitude_m)
                number += len(block)
                start_s = block[-1][0].time_s
            start_s += _TURN_S
            n_legs += 1

    def _reported(self, block: Sequence[SonarPose]) -> list[NavSample]:
        """Return the navigation samples of poses, which go into the log."""
        altitudes = [self.sea.altitude_m(pose) for pose in block]
        self._log.add(block, altitudes)
        return [self._navigation.reported(pose, altitude) for pose, altitude in zip(block, altitudes, strict=True)]

    def _depth_of_floor(self, east_m: float, north_m: float) -> float:
        return self.scene.world.depth_m - self.sea.world.floor_m(east_m, north_m)
