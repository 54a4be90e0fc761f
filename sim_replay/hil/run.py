"""Run one scenario: the mission, the fake devices, the real service, each a process of its own; then the evidence."""

from __future__ import annotations

import asyncio
import json
import signal
import time
from collections.abc import Callable, Coroutine, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import yaml

from auv_mcm.errors import HardwareError
from auv_mcm.settings.config import Config
from auv_mcm.shell.health.files import HEALTH
from auv_mcm.shell.recovery import JOURNAL
from auv_mcm.shell.whole_files import make_directory, write_file
from sim_replay.fakes.job import Job, VehicleJob
from sim_replay.hil.evidence import Line, Report, Restart
from sim_replay.hil.joined_twin import lost_by_kills, problems_of, recorded_bytes
from sim_replay.hil.mission_time import MissionTime
from sim_replay.hil.power_cut import cut_power
from sim_replay.hil.process import GRACE_S, Process
from sim_replay.hil.resources import Sample, health_age_s, pings_waiting, sampled
from sim_replay.hil.rules import AsReplayed, JoinedAsTwin, RecordedWhole, Restarted, Steady, Watched
from sim_replay.hil.scenario import Kill, Read, Scenario, service_config, service_yaml
from sim_replay.hil.service_manager import ServiceManager
from sim_replay.hil.undone import undone
from sim_replay.hil.verdict import Evidence, Placed, contacts_of, targets_of
from sim_replay.logs.recorded import RecordedMission
from sim_replay.replay import replay
from sim_replay.simulate import simulate
from sim_replay.simulator.scene_file import named_scenes, read_scene
from sim_replay.simulator.sea import Sea
from sim_replay.simulator.truth import TruthLog, truth_of

RESULTS: Final = "results"
SERVICE_LOG: Final = "service.log"
VERDICT: Final = "verdict.json"
JUNIT: Final = "junit.xml"
_SYNCED: Final = "synced.txt"  # what the service synced

_READY_S: Final = 300.0  # for a process to come up on a computer that has much else to do
_SETTLE_S: Final = 0.5  # for the service to open its ports
_DRAIN_S: Final = 0.5  # for the service to read the last of a mission; units count as silent after 1.5 s
_AFTERMATH_S: Final = 1.5  # for the service to report its reaction to a fault
_ALONE_S: Final = 4.0  # mission time of a vehicle after the service's end, to see that it goes on by itself
_LOOK_S: Final = 0.1  # between looks at the mission time
_SLOWEST: Final = 10.0  # wall time per mission time that waits for a busy computer; a run that needs more is over
_PACE_S: Final = 0.1  # s between looks whether the mission has to wait
_SAMPLE_S: Final = 0.5  # s between samples of memory
_BEHIND_PINGS: Final = 100  # that wait for perception; from there on the mission goes at real time


def run_scenario(read: Read, folder: Path, progress: Callable[[str], None]) -> Evidence:
    """Run a scenario; all its files go into `folder`, made if it is not there. progress: takes lines on its progress.

    Raises UsageError for a scene, folder or configuration that cannot be, BadInputError for a log that cannot be used,
    HardwareError for a process that does not come up; KeyboardInterrupt after SIGINT or SIGTERM.
    """
    make_directory(folder)
    scenario = read.scenario
    results = folder / RESULTS / "latest"
    for path in (results, folder / VERDICT, folder / JUNIT):
        path.unlink(missing_ok=True)  # of an earlier run, which proves nothing of this one, however it ends
    progress("mission")
    jobs: list[Job] | list[VehicleJob]
    if scenario.vehicle is None:
        log, targets = _mission(read, folder)
        jobs = [_job(scenario, name, index, log, folder) for index, name in enumerate(scenario.devices)]
    else:
        log, targets, jobs = None, _known_targets(read), [_vehicle_job(read, folder)]
    progress("devices and service")
    began_utc_s = time.time()
    live = _interruptible(_Run(scenario, folder, progress).live(jobs))
    utc_s = began_utc_s, time.time()
    config = service_config(scenario, dict.fromkeys(scenario.devices, ""), read.name)
    summary = _read_json(results / "summary.json")
    contacts = _read_json(results / "contacts.geojson")
    asked = {type(expectation.expected) for expectation in scenario.expectations}
    replayed = None
    if log is not None and AsReplayed in asked:
        progress("direct replay")
        replayed = _replayed(log, folder / "replayed", config)
    not_joined = None
    if JoinedAsTwin in asked:
        progress("joined replay, and its twin")
        not_joined = problems_of(results.resolve(), len(live.restarts) + 1, [line.text for line in live.lines])
    return Evidence(
        exit_code=live.exit_code,
        lines=live.lines,
        reports=live.reports,
        summary=summary,
        contacts=contacts_of(contacts) if contacts else (),
        targets=targets,
        replayed=replayed,
        killed_s=live.killed_s,
        stopped_s=live.stopped_s,
        fence_deg=config.vehicle.fence_deg,
        restarts=live.restarts,
        not_joined=not_joined,
        ended_s=live.ended_s,
        lost_s=lost_by_kills(results.resolve(), live.restarts) if Restarted in asked else (),
        samples=live.samples,
        managed=live.managed,
        recorded_bytes=recorded_bytes(results.resolve()) if RecordedWhole in asked else {},
        stored=contacts.get("features", ()),
        journal=_read(results / JOURNAL),
        health_age_s=health_age_s(results / HEALTH, results / "summary.json"),
        undone=undone(scenario, live.reports, live.dead, len(live.restarts), live.ended_s),
        utc_s=utc_s,
    )


class _Live(msgspec.Struct):
    """Hold the output of the processes. exit_code: of the service, None if it had to be killed. killed_s: when the
    scenario killed it. stopped_s: when it was requested to stop, None if it had ended before. ended_s: when it had
    ended. samples: of what its processes hold, where the scenario asks for them. dead: devices that ended before the
    run did. All times are mission times.
    """

    exit_code: int | None
    lines: Sequence[Line]
    reports: dict[str, list[Report]]
    killed_s: float | None
    stopped_s: float | None
    restarts: Sequence[Restart]
    ended_s: float
    samples: Sequence[Sample]
    managed: Sequence[Line]
    dead: Sequence[str]


class _Run:
    def __init__(self, scenario: Scenario, folder: Path, progress: Callable[[str], None]) -> None:
        self._scenario = scenario
        self._folder = folder
        self._progress = progress
        self._stopped_s: float | None = None
        self._devices: list[Process] = []
        self._holds: list[tuple[float, float]] = []  # for perception: when each ends, monotonic, and how long it is
        self._services: list[Process] = []  # one per start
        self._restarts: list[Restart] = []
        self._samples: list[Sample] = []
        rules = [expectation.expected for expectation in scenario.expectations]
        self._manager = ServiceManager(next((rule.watchdog_s for rule in rules if isinstance(rule, Watched)), None))
        self._is_down = False
        self._all_restarted = asyncio.Event()
        self._start_s = 0.0

    async def live(self, jobs: Sequence[Job | VehicleJob]) -> _Live:
        self._manager.listen()
        try:
            for job in jobs:
                self._devices.append(await self._device(job))
            uris: dict[str, str] = {}
            for job, process in zip(jobs, self._devices, strict=True):
                uris |= await _uris_of(process, job)
            service = await self._service(uris)
            if (limit_bytes := self._scenario.file_limit_bytes) is not None:
                service.limit_files(limit_bytes)
            self._start_s = time.monotonic() + _SETTLE_S
            for process in (*self._devices, service):  # which listens only where its clock is to step
                process.send_line(f"start {self._start_s:.6f}\n")
            killed_s = None
            if self._scenario.kill is not None:
                killed_s = await self._killed(service, self._devices[0], self._scenario.kill)
            exit_code = await self._served(uris)
            ended_s = time.monotonic()
            if self._scenario.vehicle is not None:
                await self._wait(_ALONE_S)
            dead = [process.what for process in self._devices if process.has_ended]
        finally:
            await asyncio.gather(*(process.end() for process in (*self._devices, *self._services)))
            self._manager.close()
        time_of = self._mission_time()
        lines = [Line(time_of.at(at_s), text) for service in self._services for at_s, text in service.lines]
        reports: dict[str, list[Report]] = {name: [] for name in self._scenario.devices}
        for job, process in zip(jobs, self._devices, strict=True):
            for name, report in _reports(process, time_of):
                reports[name or _name_of(job)].append(report)
        return _Live(
            exit_code=exit_code,
            lines=lines,
            reports=reports,
            killed_s=killed_s,
            stopped_s=self._stopped_s,
            restarts=self._restarts,
            ended_s=time_of.at(ended_s),
            samples=self._samples,
            managed=[Line(time_of.at(at_s), state) for at_s, state in self._manager.reports],
            dead=dead,
        )

    async def _device(self, job: Job | VehicleJob) -> Process:
        name = _name_of(job)
        path = self._folder / f"{name}.yaml"
        write_file(path, yaml.safe_dump(msgspec.to_builtins(job), sort_keys=False).encode())
        arguments = ["-m", "sim_replay.fakes", str(path)]
        log = self._folder / f"{name}.log"
        log.unlink(missing_ok=True)
        return await Process.begin(f"fake device '{name}'", arguments, log)

    def _mission_time(self) -> MissionTime:
        of_devices = [(at_s, hold_s) for process in self._devices for at_s, hold_s in process.holds]
        return MissionTime(self._start_s, sorted(of_devices + self._holds))

    async def _wait(self, for_s: float) -> None:
        """Wait for a mission time, or for _SLOWEST times as long."""
        now_s = time.monotonic()
        until_s = self._mission_time().at(now_s) + for_s
        while (left_s := until_s - self._mission_time().at(time.monotonic())) > 0.0:
            if time.monotonic() - now_s > _SLOWEST * for_s:
                self._progress(
                    f"this computer makes {for_s:g} s of mission time in more than {_SLOWEST * for_s:g} s: given up"
                )
                return
            await asyncio.sleep(min(left_s, _LOOK_S) if self._can_wait else left_s)

    @property
    def _can_wait(self) -> bool:
        """Find whether mission time may stand still."""
        return self._scenario.waits or self._scenario.vehicle is not None

    async def _pace(self) -> None:
        """Let every device wait for one that is late.

        While the service is down or perception is behind the mission goes at real time: it never stands still, which
        would be a fault of the ports, and what a restart takes does not depend on its speed. With power cuts it stands
        still while the service is down.
        """
        n_seen = [0] * len(self._devices)
        while True:
            for index, late in enumerate(self._devices):
                for _, for_s in late.holds[n_seen[index] :]:
                    for other in self._devices:
                        if other is not late:
                            other.send_line(f"hold {for_s:.4f}\n")
                n_seen[index] = len(late.holds)
            still_s = _PACE_S * max(1.0 - 1.0 / self._scenario.speed, 0.0)
            if self._is_down and self._scenario.power_cut_every is not None:
                still_s = _PACE_S
            is_behind = pings_waiting(self._folder / RESULTS / "latest" / HEALTH) > _BEHIND_PINGS
            if still_s and (self._is_down or is_behind):
                self._holds.append((time.monotonic() + still_s, still_s))
                for device in self._devices:
                    device.send_line(f"hold {still_s:.4f}\n")
            await asyncio.sleep(_PACE_S)

    async def _sample(self) -> None:
        """Note what the processes of the service hold, where the scenario asks for it."""
        while any(isinstance(expectation.expected, Steady) for expectation in self._scenario.expectations):
            await asyncio.sleep(_SAMPLE_S)
            found = sampled(self._services[-1].pid, len(self._services), self._mission_time().at(time.monotonic()))
            self._samples += [] if found is None else [found]

    async def _killed(self, service: Process, vehicle: Process, kill: Kill) -> float | None:
        """Kill the service as the scenario requests and wait until the run is over.

        Returns the time of the kill after the start; None: control was never granted.
        """
        if not await self._any_reported([vehicle], "granted"):
            return None
        await self._wait(kill.after_grant_s)
        self._progress("killing the service")
        service.signal(signal.SIGKILL)
        killed_s = self._mission_time().at(time.monotonic())
        await self._wait(kill.rest_s)
        return killed_s

    async def _any_reported(self, devices: Sequence[Process], what: str, containing: str = "") -> bool:
        """Wait until a device reports something, or the run has lasted as long as it may. Returns whether one did."""
        printed = [asyncio.ensure_future(device.printed(f'"what": "{what}"', None, containing)) for device in devices]
        ends = asyncio.ensure_future(self._wait(self._left_s()))
        try:
            await asyncio.wait({*printed, ends}, return_when=asyncio.FIRST_COMPLETED)
            return any(task.done() and task.exception() is None for task in printed)
        finally:
            for task in (*printed, ends):
                task.cancel()

    def _left_s(self) -> float:
        """Compute how much mission time is left of the run."""
        return max(0.0, self._scenario.run_s - self._mission_time().at(time.monotonic()))

    async def _service(self, uris: dict[str, str]) -> Process:
        path = self._folder / "service.yaml"
        write_file(path, service_yaml(self._scenario, uris, self._folder / RESULTS).encode())
        step = self._scenario.host_clock_step
        arguments = ["-m", "auv_mcm", "run", "--config", str(path)]
        if step is not None:
            arguments = ["-m", "sim_replay.hil.stepping_service", str(path), str(step.at_s), str(step.by_s)]
        elif self._scenario.power_cut_every is not None:
            arguments = ["-m", "sim_replay.hil.power_cut", str(path), str(self._folder / _SYNCED)]
        if not self._services:
            (self._folder / SERVICE_LOG).unlink(missing_ok=True)
            (self._folder / _SYNCED).unlink(missing_ok=True)
        service = await Process.begin("the service", arguments, self._folder / SERVICE_LOG, self._manager.environment)
        self._services.append(service)
        await service.printed("ready: ", _READY_S)
        return service

    async def _served(self, uris: dict[str, str]) -> int | None:
        """Wait until the run is over, signal the service to stop, and wait for its end."""
        scenario = self._scenario
        self._progress(f"running for {scenario.run_s:g} s" + ("" if scenario.ends_after is None else " at most"))
        over = asyncio.ensure_future(self._over(self._devices))
        ended = asyncio.ensure_future(self._ended(uris))
        pacing = asyncio.ensure_future(self._pace() if scenario.waits else asyncio.Event().wait())
        sampling = asyncio.ensure_future(self._sample())
        try:
            await asyncio.wait({over, ended, pacing}, return_when=asyncio.FIRST_COMPLETED)
            if ended.done():
                return ended.result()
            if pacing.done():
                pacing.result()
        finally:
            for task in (over, ended, pacing, sampling):
                task.cancel()
        self._progress("stopping")
        self._stopped_s = self._mission_time().at(time.monotonic())  # before, as the answer may come at once
        self._services[-1].signal(signal.SIGTERM)
        try:
            return await self._services[-1].ended(scenario.stop_within_s + GRACE_S)
        except TimeoutError:
            return None

    async def _ended(self, uris: dict[str, str]) -> int:
        """Kill the service and start it again as the scenario requests; return the exit code of the last start."""
        for at_s in self._scenario.restarts_s:
            ended = asyncio.ensure_future(self._services[-1].ended(None))
            waiting = asyncio.ensure_future(self._wait(max(at_s - self._mission_time().at(time.monotonic()), 0.0)))
            try:
                await asyncio.wait({ended, waiting}, return_when=asyncio.FIRST_COMPLETED)
                if ended.done():
                    return ended.result()
            finally:
                ended.cancel()
                waiting.cancel()
            self._progress(f"killing the service after {at_s:g} s and starting it again")
            mono_s = time.monotonic()
            killed_s = self._mission_time().at(mono_s)
            self._is_down = True
            await self._services[-1].kill()
            if (every := self._scenario.power_cut_every) is not None and (len(self._restarts) + 1) % every == 0:
                session, notes = (self._folder / RESULTS / "latest").resolve(), self._folder / _SYNCED
                n_gone = cut_power(session, notes, np.random.default_rng((self._scenario.seed, notes.stat().st_size)))
                self._progress(f"a power cut takes {n_gone} bytes")
            for device in self._devices:
                device.send_line("hang_up 0\n")
            await self._service(uris)
            self._is_down = False
            self._restarts.append(Restart(killed_s, self._mission_time().at(time.monotonic()), mono_s))
        self._all_restarted.set()
        return await self._services[-1].ended(None)

    async def _over(self, devices: Sequence[Process]) -> None:
        """Return when the run is over, and all its restarts are made."""
        await self._flown(devices)
        await self._all_restarted.wait()

    async def _flown(self, devices: Sequence[Process]) -> None:
        rule = self._scenario.ends_after
        if rule is not None:
            if await self._any_reported(devices, rule.what, rule.containing):
                await self._wait(rule.after_s)
        elif self._scenario.vehicle is not None:
            await self._wait(self._left_s())
        else:
            await self._played(devices, self._left_s())

    async def _played(self, devices: Sequence[Process], left_s: float) -> None:
        """Wait until every device has played its mission and every fault has ended, for `left_s` seconds at most.

        A device that has nothing more to play is silent, which the service would rightly report as a fault.
        """
        faults = [fault for device in self._scenario.devices.values() for fault in device.faults]
        step = self._scenario.host_clock_step
        last_s = max([fault.at_s + (fault.for_s or 0.0) for fault in faults] + [0.0 if step is None else step.at_s])
        earliest_s = time.monotonic() + left_s - self._scenario.run_s + last_s + _AFTERMATH_S
        left_s *= _SLOWEST if self._scenario.waits else 1.0
        ends_s = time.monotonic() + left_s
        try:
            async with asyncio.TaskGroup() as tasks:
                for device in devices:
                    tasks.create_task(device.printed('"what": "done"', left_s))
            ends_s = min(ends_s, max(time.monotonic() + _DRAIN_S, earliest_s))
        except* HardwareError:
            pass  # longer than the run, or a device ended, which gives the reason in its log and fails its expectations
        await asyncio.sleep(max(0.0, ends_s - time.monotonic()))


def _mission(read: Read, folder: Path) -> tuple[Path, list[Placed]]:
    """Return the log to play, simulated where the scenario names a scene, and its known targets."""
    if read.scenario.log is not None:
        log = read.folder / read.scenario.log
        RecordedMission([log], Config())  # refuses what cannot be used
        return log, []
    simulated = simulate(read_scene(_scene_of(read)), folder)
    return simulated.log, targets_of(_read_json(simulated.truth))


def _known_targets(read: Read) -> list[Placed]:
    """Return the targets of a scene before a flight through it."""
    sea = Sea(read_scene(_scene_of(read)))
    return targets_of(truth_of(sea, TruthLog(sea)))


def _scene_of(read: Read) -> str:
    """Return the name of a shipped scene, or the path of a file."""
    assert read.scenario.scene is not None
    name = read.scenario.scene
    return name if name in named_scenes() else str((read.folder / name).resolve())


def _vehicle_job(read: Read, folder: Path) -> VehicleJob:
    scenario = read.scenario
    return VehicleJob(devices=scenario.devices, folder=str(folder.resolve()), scene=_scene_of(read), seed=scenario.seed)


def _name_of(job: Job | VehicleJob) -> str:
    return job.name if isinstance(job, Job) else next(name for name, device in job.devices.items() if device.is_vehicle)


def _job(scenario: Scenario, name: str, index: int, log: Path, folder: Path) -> Job:
    return Job(
        name=name,
        device=scenario.devices[name],
        folder=str(folder.resolve()),
        log=str(log.resolve()),
        speed=scenario.speed,
        seed=scenario.seed + index,
        waits=scenario.waits,
    )


def _replayed(log: Path, folder: Path, config: Config) -> list[Placed]:
    replay([log], folder, config)
    return contacts_of(_read_json(folder / "contacts.geojson"))


async def _uris_of(device: Process, job: Job | VehicleJob) -> dict[str, str]:
    """Return addresses of a device's wire, or of those of a vehicle, by name."""
    ready = (
        {job.name: '"what": "ready"'}
        if isinstance(job, Job)
        else {name: f'"ready", "device": "{name}"' for name in job.devices}
    )
    return {name: str(json.loads(await device.printed(text, _READY_S))["uri"]) for name, text in ready.items()}


def _reports(device: Process, time_of: MissionTime) -> Iterator[tuple[str | None, Report]]:
    """Parse reports, with the name of the device where a line gives one."""
    for _, line in device.lines:
        if line.startswith("{"):
            details = json.loads(line)
            yield details.pop("device", None), Report(time_of.at(details.pop("mono_s")), details.pop("what"), details)


def _read_json(path: Path) -> Any:
    """Read a JSON file, {} if it is not there."""
    return json.loads(_read(path) or b"{}")


def _read(path: Path) -> bytes:
    """Read a file, b"" if it is not there."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return b""


def _interruptible(live: Coroutine[Any, Any, _Live]) -> _Live:
    """Run to the end, or until SIGINT or SIGTERM, which cleans up first."""

    async def main() -> _Live:
        running = asyncio.ensure_future(live)
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, running.cancel)
        return await running

    try:
        return asyncio.run(main())
    except asyncio.CancelledError:
        raise KeyboardInterrupt from None
