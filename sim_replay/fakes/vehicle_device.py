"""Run a fake vehicle: one world, one vehicle in it, and the wires of its sonar, its navigation and its controller.

The vehicle flies in real time, in blocks of a few pings. The echoes of a block are made while the block before is
played, of the way that the command of that moment makes it go: a command takes effect one to two blocks, 0.1 to 0.4 s
at 20 pings a second, after it has come.

On a computer that is too slow the mission waits: its time stands still until the next block is made and every device
has got rid of what is due, so that nothing is left out and what the vehicle does depends on mission time alone.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from msgspec import structs

from auv_mcm.errors import UsageError
from auv_mcm.records import NavSample, Ping
from sim_replay.fakes.controller import ReportingController
from sim_replay.fakes.device import FakeDevice
from sim_replay.fakes.feed import TimedEvent
from sim_replay.fakes.job import Job, VehicleJob
from sim_replay.fakes.vehicles.bluefin import FakeBluefin
from sim_replay.fakes.vehicles.can import FakeCan
from sim_replay.fakes.vehicles.fake_vehicle import FakeController
from sim_replay.fakes.vehicles.imc import FakeImc
from sim_replay.fakes.vehicles.iver import FakeIver
from sim_replay.fakes.vehicles.recon import FakeRecon
from sim_replay.fakes.wires import DeviceWire
from sim_replay.simulator.navigation_error import NavigationModel
from sim_replay.simulator.objects import PlacedObject
from sim_replay.simulator.plan import local_frame, planned_legs
from sim_replay.simulator.scene_file import read_scene
from sim_replay.simulator.sea import Sea
from sim_replay.simulator.steered import SteeredVehicle
from sim_replay.simulator.vehicle import SonarPose

MakeController = Callable[[], FakeController[Any]]
ReportOf = Callable[[str, str, dict[str, Any]], None]

CONTROLLERS: Final[Mapping[str, MakeController]] = MappingProxyType(
    {"imc": FakeImc, "bluefin": FakeBluefin, "iver": FakeIver, "recon": FakeRecon, "vehicle_can": FakeCan}
)
_BLOCK: Final = 4  # pings
_TICK_HZ: Final = 10.0  # of the controller
_POSE_S: Final = 1.0  # between reports of where it is
_STRAIGHT_RAD_S: Final = math.radians(15.0)  # turning no faster, it looks at what it passes


class Pass(NamedTuple):
    """Record a target abeam. number: of the scene's targets. look_rad: from the vehicle to it, clockwise from north."""

    number: int
    ground_range_m: float
    look_rad: float


class FakeVehicle:
    """Run the vehicle of one run. report(device, what, details): which event happens to which device.

    Besides what its devices and its controller report, in the name of the controller: `pose` (once a second: where it
    truly is, and whether the payload commands), `leg` (number: of its own plan, flown to its end), `passed` (a target
    abeam on a straight run: number, ground_range_m, look_deg, in_control), `held` (for_s: mission time stood still so
    long, until now). counters: world.held_ms, their sum.
    """

    def __init__(self, job: VehicleJob, report: ReportOf, make_controller: MakeController | None = None) -> None:
        scene = read_scene(job.scene)
        if scene.sonar.synthetic_aperture is not None:
            raise UsageError(
                f"scene {job.scene}: a synthetic aperture is made of whole legs and cannot be steered; leave it out"
            )
        self._name, controls = next((name, device) for name, device in job.devices.items() if device.is_vehicle)
        self._report = report
        self._sea = Sea(scene)
        self._frame = local_frame(scene.origin)
        self._vehicle = SteeredVehicle(
            scene.track, planned_legs(scene.track.plan), scene.seed, self._frame, self._depth_of_floor
        )
        self._navigation = NavigationModel(scene.navigation_error, scene.origin, scene.seed)
        self._rate_hz = scene.sonar.ping_rate_hz
        self._targets = [scene_object for scene_object in self._sea.objects if scene_object.is_target]
        self._counters: Counter[str] = Counter()
        self._start_s = 0.0
        make = make_controller or CONTROLLERS[controls.device]
        self._controller = ReportingController(
            make(), job.seed, lambda what, details: report(self._name, what, details)
        )
        self._queues: dict[str, asyncio.Queue[TimedEvent]] = {name: asyncio.Queue() for name in job.devices}
        self._is_sonar = {name: device.is_sonar for name, device in job.devices.items()}
        self.devices: Final = {
            name: FakeDevice(
                Job(name=name, device=device, folder=job.folder, scene=job.scene, seed=job.seed + index),
                _taken_from(self._queues[name]),
                _named(report, name),
                self._controller if device.is_vehicle else None,
                self._standing(),
                self._hold,
            )
            for index, (name, device) in enumerate(job.devices.items())
        }

    @property
    def wires(self) -> list[DeviceWire]:
        """List the wires of its devices."""
        return [device.wire for device in self.devices.values()]

    async def run(self, start: Awaitable[float]) -> None:
        """Serve the hosts, and fly from the instant of the monotonic clock that `start` gives.

        It does not end by itself.
        """
        started = asyncio.ensure_future(start)
        async with asyncio.TaskGroup() as tasks:
            for device in self.devices.values():
                tasks.create_task(device.run(asyncio.shield(started)))
            await self._fly(await asyncio.shield(started))

    async def end(self) -> None:
        """Close for good, and report the counters."""
        for name, device in self.devices.items():
            await device.wire.close()
            counters = device.counters + (self._counters if name == self._name else Counter())
            self._report(name, "counters", dict(counters))

    def _standing(self) -> NavSample:
        """Return the navigation sample before the vehicle moves."""
        scene = self._sea.scene
        (pose,) = SteeredVehicle(scene.track, self._vehicle.legs, scene.seed, self._frame, self._depth_of_floor).fly(
            1, self._rate_hz
        )
        sample = NavigationModel(scene.navigation_error, scene.origin, scene.seed).reported(
            pose, self._sea.altitude_m(pose)
        )
        return structs.replace(sample, speed_mps=0.0)

    async def _fly(self, start_s: float) -> None:
        self._start_s = start_s
        number, legs_flown, next_pose_s, next_tick_s = 0, 0, 0.0, 0.0
        before: SonarPose | None = None
        while True:
            for device in self.devices.values():
                device.give_until(number / self._rate_hz)
            await asyncio.sleep(max(self._start_s + (number - _BLOCK) / self._rate_hz - time.monotonic(), 0.0))
            self._vehicle.steer(self._controller.steered)
            poses = self._vehicle.fly(_BLOCK, self._rate_hz)
            reported = [self._navigation.reported(pose, self._sea.altitude_m(pose)) for pose in poses]
            silent = self._vehicle.done and self._controller.steered is None
            pings: list[Ping] = [] if silent else await asyncio.to_thread(self._sound, poses, number, reported)
            late_s = time.monotonic() - self._start_s - number / self._rate_hz
            if late_s > 0.0:
                self._hold(late_s)
            for index, (pose, sample) in enumerate(zip(poses, reported, strict=True)):
                at_s = (number + index) / self._rate_hz
                ticks = at_s >= next_tick_s
                next_tick_s += ticks / _TICK_HZ
                self._give(at_s, sample, pings[index] if pings else None, ticks=ticks)
                if at_s >= next_pose_s:
                    next_pose_s += _POSE_S
                    self._report(self._name, "pose", self._described(pose, at_s))
                for passed in (
                    [] if before is None else passes(before, pose, self._targets, self._sea.scene.sonar.range_m)
                ):
                    self._report(self._name, "passed", self._passed(passed))
                before = pose
            if self._vehicle.legs_flown > legs_flown:
                self._report(self._name, "leg", {"number": legs_flown})
                legs_flown = self._vehicle.legs_flown
            number += _BLOCK

    def _hold(self, late_s: float) -> None:
        """Let the mission wait: events due that long ago are due now."""
        self._start_s += late_s
        for device in self.devices.values():
            device.hold(late_s)
        self._counters["world.held_ms"] += math.ceil(1e3 * late_s)
        self._report(self._name, "held", {"for_s": round(late_s, 4)})

    def _sound(self, poses: Sequence[SonarPose], number: int, reported: Sequence[NavSample]) -> list[Ping]:
        return self._sea.sound(poses, number, [sample.altitude_m for sample in reported])

    def _give(self, at_s: float, sample: NavSample, ping: Ping | None, *, ticks: bool) -> None:
        """Pass to each device the events that concern it."""
        for name, queue in self._queues.items():
            if self._is_sonar[name]:
                if ping is not None:
                    queue.put_nowait(TimedEvent(at_s, structs.replace(ping, time_s=at_s)))
            elif name != self._name or ticks:
                queue.put_nowait(TimedEvent(at_s, structs.replace(sample, time_s=at_s)))

    def _described(self, pose: SonarPose, at_s: float) -> dict[str, Any]:
        latitude_deg, longitude_deg, _ = self._frame.to_geodetic((pose.east_m, pose.north_m, 0.0))
        return {
            "at_s": round(at_s, 3),
            "latitude_deg": round(float(latitude_deg), 8),
            "longitude_deg": round(float(longitude_deg), 8),
            "heading_deg": round(math.degrees(pose.heading_rad) % 360.0, 2),
            "depth_m": round(pose.depth_m, 2),
            "altitude_m": round(self._sea.altitude_m(pose), 2),
            "speed_mps": round(pose.speed_mps, 2),
            "leg": pose.on_leg,
            "in_control": self._controller.in_control,
        }

    def _passed(self, passed: Pass) -> dict[str, Any]:
        return {
            "number": passed.number,
            "ground_range_m": round(passed.ground_range_m, 2),
            "look_deg": round(math.degrees(passed.look_rad) % 360.0, 1),
            "in_control": self._controller.in_control,
        }

    def _depth_of_floor(self, east_m: float, north_m: float) -> float:
        return self._sea.scene.world.depth_m - self._sea.world.floor_m(east_m, north_m)


def passes(before: SonarPose, pose: SonarPose, targets: Sequence[PlacedObject], range_m: float) -> list[Pass]:
    """Yield targets that came abeam between two poses, no farther than range_m, while the vehicle hardly turned."""
    turn_rad = math.remainder(pose.heading_rad - before.heading_rad, 2.0 * math.pi)
    if abs(turn_rad) > _STRAIGHT_RAD_S * (pose.time_s - before.time_s):
        return []
    found = []
    for number, target in enumerate(targets):
        if _ahead_m(before, target) > 0.0 >= _ahead_m(pose, target):
            east_m, north_m = target.east_m - pose.east_m, target.north_m - pose.north_m
            if (ground_range_m := math.hypot(east_m, north_m)) <= range_m:
                found.append(Pass(number, ground_range_m, math.atan2(east_m, north_m)))
    return found


def _ahead_m(pose: SonarPose, target: PlacedObject) -> float:
    return (target.east_m - pose.east_m) * math.sin(pose.heading_rad) + (target.north_m - pose.north_m) * math.cos(
        pose.heading_rad
    )


async def _taken_from(queue: asyncio.Queue[TimedEvent]) -> AsyncIterator[TimedEvent]:
    while True:
        yield await queue.get()


def _named(report: ReportOf, name: str) -> Callable[[str, dict[str, Any]], None]:
    return lambda what, details: report(name, what, details)
