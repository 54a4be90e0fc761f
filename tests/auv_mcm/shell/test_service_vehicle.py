"""The service and a vehicle: contacts reported once on disk, health as it is, legs requested, and control returned on
every way out.
"""

from __future__ import annotations

import asyncio
import json
import math
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import pytest

from auv_mcm.errors import AuvMcmError
from auv_mcm.records import NAN, Contact, Notice, Waypoint
from auv_mcm.settings.config import Config, ServiceConfig
from auv_mcm.settings.plan_settings import PlanConfig
from auv_mcm.settings.vehicle_settings import VehicleConfig
from auv_mcm.shell.health.judge import Computer
from auv_mcm.shell.perception_chain import MakePipeline
from auv_mcm.shell.service import Service
from auv_mcm.source import AnnouncedContact, EventSink
from tests.auv_mcm.shell import fake_pipelines as fake
from tests.auv_mcm.shell import service_runs

FENCED = VehicleConfig(command=True, fence_deg=((42.99, 4.99), (42.99, 5.01), (43.01, 5.01), (43.01, 4.99)))


class Vehicle:
    """Record what the service reports to it, in order."""

    def __init__(self) -> None:
        self.authority = "listening"
        self.counters: Counter[str] = Counter({"vehicle.reports_told": 1})
        self.reports: list[tuple[str, Any]] = []
        self.on_contact: Callable[[Contact], None] = lambda contact: None

    def health(self) -> str:
        return f"vehicle={self.authority}"

    def take_notices(self) -> list[Notice]:
        return []

    def go_on(self, session: int, n_starts: int, announced: Mapping[int, AnnouncedContact]) -> None:
        self.announced = announced
        if n_starts:
            self.reports.append(("go on", n_starts))

    def report(self, contact: Contact) -> None:
        self.reports.append(("contact", contact.id))
        self.on_contact(contact)

    def propose(self, plan: tuple[Waypoint, ...]) -> None:
        self.reports.append(("plan", plan))

    def report_health(self, state: str, text: str) -> None:
        self.reports.append((state, text))

    def release(self, reason: str) -> None:
        self.reports.append(("release", reason))

    def words(self) -> list[str]:
        return [word for word, _ in self.reports]


class Ports(service_runs.Ports):
    """A live source with a vehicle; it gives pings and navigation at 100 Hz until it is stopped."""

    def __init__(self, vehicle: Vehicle | None = None) -> None:
        super().__init__(())
        self.vehicle: Vehicle = vehicle or Vehicle()
        self.wrong: list[str] = []
        self.unlike: dict[str, Any] = {}  # what navigation gives otherwise
        self.is_served = False

    def faults(self) -> list[str]:
        return list(self.wrong)

    def counters(self) -> Counter[str]:
        return self.vehicle.counters

    async def serve_vehicle(self) -> None:
        self.is_served = True
        try:
            await asyncio.Event().wait()
        finally:
            self.is_served = False

    async def run(self, sink: EventSink) -> None:
        number = 0
        while not self._stopped.is_set():
            sink.push(msgspec.structs.replace(fake.navigation(number % 10), **self.unlike))
            sink.push(fake.ping(number))
            number += 1
            await asyncio.sleep(0.01)


def serve(
    folder: Path,
    ports: Ports,
    until: Callable[[], bool],
    make: MakePipeline = fake.Base,
    vehicle: VehicleConfig = FENCED,
    cancel: bool = False,
    plan: PlanConfig | None = None,
) -> Path:
    """Serve until something is so, then stop."""

    async def main() -> Path:
        service_config = ServiceConfig(
            output_directory=str(folder),
            record=False,
            queue_pings=100_000,  # pings come by this computer's clock, while perception starts as soon as it can
            stop_within_s=60.0,
        )
        config = Config(service=service_config, vehicle=vehicle, plan=plan or PlanConfig())
        service = Service(config, ports, console=lambda line: None, make_pipeline=make)
        serving = asyncio.ensure_future(service.run())
        async with asyncio.timeout(120.0):
            while not until() and not serving.done():
                await asyncio.sleep(0.01)
        if cancel:
            serving.cancel()
        service.stop()
        return await serving

    return asyncio.run(main())


def test_contacts_are_reported_once_they_are_on_disk_and_the_vehicle_is_left_in_order(tmp_path: Path) -> None:
    def is_on_disk(contact: Contact) -> None:
        assert contact.id in (tmp_path / "latest" / "contacts.jsonl").read_text()

    ports = Ports()
    ports.vehicle.on_contact = is_on_disk

    def is_reporting() -> bool:
        words = ports.vehicle.words()
        return words.count("contact") >= 3 and "normal" in words

    results = serve(tmp_path, ports, is_reporting)
    stated = ports.vehicle.words()
    assert stated[0] == "starting"
    assert stated.index("normal") < stated.index("release") < stated.index("failure")
    assert stated[-2:] == ["release", "failure"]
    last = max(k for k, word in enumerate(stated) if word == "contact")
    assert ports.vehicle.reports[last] == ("contact", "C9999")  # those of the very end as well
    assert stated.index("release") < last  # but control goes back as soon as the service is to stop
    assert not ports.is_served
    summary = json.loads((results / "summary.json").read_bytes())
    assert summary["vehicle"] == "vehicle=listening"
    assert summary["counters"]["vehicle.reports_told"] == 1


def test_what_is_wrong_is_reported_and_that_it_is_well_again(tmp_path: Path) -> None:
    ports = Ports()
    steps = iter(range(3))

    def healths() -> list[tuple[str, Any]]:
        return [stated for stated in ports.vehicle.reports if stated[0] in ("normal", "fault")]

    def until() -> bool:
        if healths()[-1:] == [("normal", "")] and not ports.wrong:
            ports.wrong = ["port sonar is down"]
            return next(steps) == 1
        if healths()[-1:] == [("fault", "port sonar is down")]:
            ports.wrong = []
        return False

    serve(tmp_path, ports, until)
    assert healths()[:3] == [("normal", ""), ("fault", "port sonar is down"), ("normal", "")]


def test_a_full_disk_is_no_normal_health_for_the_vehicle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("auv_mcm.shell.service.measure_computer", lambda folder: Computer(5e7, NAN, math.inf))
    ports = Ports()
    serve(tmp_path, ports, lambda: "fault" in ports.vehicle.words() or "normal" in ports.vehicle.words())
    assert ("fault", "disk full") in ports.vehicle.reports
    assert "normal" not in ports.vehicle.words()


@pytest.mark.parametrize(
    ("make", "reason"),
    [(fake.Failing, "perception failed"), (fake.Dying, "was killed by SIGKILL"), (fake.Unstartable, "no model file")],
)
def test_a_perception_that_fails_is_reported_and_control_goes_back(
    tmp_path: Path, make: MakePipeline, reason: str
) -> None:
    ports = Ports()
    with pytest.raises(AuvMcmError, match=reason):
        serve(tmp_path, ports, lambda: False, make)
    assert [word for word, _ in ports.vehicle.reports[-2:]] == ["release", "failure"]
    assert all(reason in text for _, text in ports.vehicle.reports[-2:])
    assert not ports.is_served


def test_a_service_that_is_ended_at_once_gives_control_back_all_the_same(tmp_path: Path) -> None:
    ports = Ports()
    with pytest.raises(asyncio.CancelledError):
        serve(tmp_path, ports, lambda: "contact" in ports.vehicle.words(), cancel=True)
    assert "release" in ports.vehicle.words()
    assert not ports.is_served


def test_legs_are_requested_and_the_last_request_is_among_the_results(tmp_path: Path) -> None:
    ports = Ports()
    results = serve(tmp_path, ports, lambda: "plan" in ports.vehicle.words(), fake.Undecided)
    plan = next(what for word, what in ports.vehicle.reports if word == "plan")
    assert {point.contact_id for point in plan} == {"C0000"}
    written = json.loads((results / "waypoints.geojson").read_bytes())["features"]
    assert "C0000" in json.dumps(written)
    assert "plan" not in ports.vehicle.words()[ports.vehicle.words().index("release") :]


def test_without_a_compass_legs_are_requested_from_the_course(tmp_path: Path) -> None:
    ports = Ports()
    ports.unlike = {"heading_rad": NAN}
    serve(tmp_path, ports, lambda: "plan" in ports.vehicle.words(), fake.Undecided)
    start = next(what for word, what in ports.vehicle.reports if word == "plan")[0]
    assert abs(math.sin(start.heading_rad)) < 1e-6, "it goes north, and back at once"


@pytest.mark.filterwarnings("ignore::auv_mcm.defects.DefectWarning")
def test_a_defect_of_planning_gives_control_back_and_ends_nothing_else(tmp_path: Path) -> None:
    class Stumbling(Vehicle):
        def propose(self, plan: tuple[Waypoint, ...]) -> None:
            super().propose(plan)
            raise ValueError("slip of the pen")

    ports = Ports(Stumbling())
    failed = ("fault", "planning failed")

    def until() -> bool:
        if failed in ports.vehicle.reports:
            ports.wrong = ["port sonar is silent"]
        both = ("fault", "port sonar is silent; planning failed")
        return both in ports.vehicle.reports and "contact" in ports.vehicle.words()

    results = serve(tmp_path, ports, until, fake.Undecided)
    assert ports.vehicle.words().count("plan") == 1
    assert ports.vehicle.reports.index(("release", "planning failed")) < ports.vehicle.reports.index(failed)
    assert ("contact", "C9999") in ports.vehicle.reports, "those of the end as well"
    (notice,) = (
        one for one in json.loads((results / "summary.json").read_bytes())["notices"] if "planning" in one["code"]
    )
    assert notice["code"] == "vehicle.planning_failed"
    assert "slip of the pen" in notice["text"]


@pytest.mark.parametrize("vehicle", [VehicleConfig(), FENCED])
def test_how_far_an_area_is_cleared_is_reported_to_the_vehicle_and_left_in_the_results(
    tmp_path: Path, vehicle: VehicleConfig
) -> None:
    ports = Ports()
    plan = PlanConfig(area_deg=((43.0, 5.0), (43.0, 5.001), (43.001, 5.001)))
    reported = ("normal", "clearance 0.00 of 0.90")
    results = serve(tmp_path, ports, lambda: reported in ports.vehicle.reports, vehicle=vehicle, plan=plan)
    summary = json.loads((results / "summary.json").read_bytes())
    assert summary["area"]["p_detected_mean"] == 0.0
    assert summary["area"]["km2"] == pytest.approx(0.5 * 0.111 * 0.0815, rel=0.1)
    assert summary["vehicle"] == "vehicle=listening clearance 0.00 of 0.90"
    assert ("plan", ()) not in ports.vehicle.reports


@pytest.mark.parametrize(
    ("fence_deg", "is_far"),
    [
        (((4.99, 42.99), (5.01, 42.99), (5.01, 43.01), (4.99, 43.01)), True),
        (((42.9, 4.9), (42.9, 5.1), (43.1, 5.1), (43.1, 4.9)), False),
    ],
)
def test_a_fence_with_longitude_before_latitude_is_reported_as_soon_as_the_vehicle_has_a_place(
    fence_deg: tuple[tuple[float, float], ...], is_far: bool, tmp_path: Path
) -> None:
    ports = Ports()
    vehicle = VehicleConfig(command=True, fence_deg=fence_deg)
    results = serve(tmp_path, ports, lambda: "normal" in ports.vehicle.words(), vehicle=vehicle)
    notices = json.loads((results / "summary.json").read_bytes())["notices"]
    texts = [notice["text"] for notice in notices if notice["code"] == "bounds_far_away"]
    assert len(texts) == is_far
    assert all(" km from vehicle.fence_deg, " in text and "[latitude, longitude]" in text for text in texts)


def test_early_contacts_reach_the_vehicle_once_on_disk_are_taken_back_after_their_contact_and_request_no_leg(
    tmp_path: Path,
) -> None:
    def take(contact: Contact) -> None:
        if contact.id.startswith("E"):
            assert contact.id in (tmp_path / "latest" / "early.jsonl").read_text()
            reported.append((contact.id, contact.p_mine))
        else:
            reported.append((contact.id, 0.25))

    reported: list[tuple[str, float]] = []
    ports = Ports()
    ports.vehicle.on_contact = take
    serve(tmp_path, ports, lambda: len(reported) >= 8, fake.Early)
    assert [each for each in reported if each[0].startswith("E")] == [
        ("E00001", 0.6),
        ("E00002", 0.6),
        ("E00001", 0.0),
        ("E00002", 0.0),
    ]
    assert reported.index(("C0003", 0.25)) < reported.index(("E00001", 0.0))
    assert "plan" not in ports.vehicle.words()


def test_after_a_restart_the_vehicle_gets_all_contacts_again_under_their_numbers(tmp_path: Path) -> None:
    before, after = Ports(), Ports()
    with pytest.raises(asyncio.CancelledError):
        serve(tmp_path, before, lambda: before.vehicle.words().count("contact") >= 3, cancel=True)
    results = serve(tmp_path, after, lambda: after.vehicle.words().count("contact") >= 4)
    assert after.vehicle.reports[:2] == [("go on", 1), ("starting", "the payload starts")]
    known = {number for word, number in before.vehicle.reports if word == "contact"}
    assert {f"C{number:04d}" for number in after.vehicle.announced} >= known
    assert all(each.n_revisions and each.p_mine for each in after.vehicle.announced.values())
    assert known <= {number for word, number in after.vehicle.reports if word == "contact"}
    journal = [json.loads(line) for line in (results / "contacts.jsonl").read_text().splitlines()]
    announced = [(line["event"], line["contact"]["properties"]["id"]) for line in journal]
    assert len(announced) == len(set(announced)), "what was announced is not announced again"


def test_a_plan_requested_from_a_perception_that_dies_comes_from_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAILED_ONCE", str(tmp_path / "failed"))
    ports = Ports()
    serve(tmp_path, ports, lambda: "plan" in ports.vehicle.words(), make=fake.DyingOverAPlanOnce)
    assert (tmp_path / "failed").exists()
    plan = next(plan for word, plan in ports.vehicle.reports if word == "plan")
    assert {waypoint.contact_id for waypoint in plan if waypoint.contact_id} == {"C0000"}
