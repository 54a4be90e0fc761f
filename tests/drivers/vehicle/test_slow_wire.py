"""A flood of contacts on a slow serial line holds up no command and no word of health, and all contacts arrive."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, Final

import pytest

from auv_mcm.clock import Stamp
from drivers.links.slcan import encode
from drivers.port_source import PortSource
from drivers.ports import read_ports
from drivers.vehicle.vehicles import VehicleSettings, decoder_of
from sim_replay.fakes.vehicles.can import FakeCan
from sim_replay.fakes.vehicles.fake_vehicle import FakeController
from sim_replay.fakes.vehicles.imc import FakeImc
from sim_replay.fakes.vehicles.iver import FakeIver
from sim_replay.fakes.vehicles.recon import FakeRecon
from tests.drivers.port_traffic import config_of
from tests.drivers.test_port_source_vehicle import VEHICLE, contact
from tests.make.records import nav_of
from tests.manual_clock import ManualClock

N_CONTACTS: Final = 300
TICK_S: Final = 0.05
BITS: Final = 10  # of a byte on the line


class Line:
    """Fake the link of a port: it takes all, and counts how long that lasts at a rate. on_item: is given each item."""

    place, state = "line", "up"

    def __init__(self, baud: int, clock: ManualClock, on_item: Callable[[Any], None]) -> None:
        self.counters: Counter[str] = Counter()
        self.longest_wait_s = 0.0
        self._baud, self._clock, self._on_item = baud, clock, on_item
        self._free_s = 0.0

    def write(self, item: Any) -> bool:
        n_bytes = len(item) if isinstance(item, bytes) else len(encode(item))
        now_s = self._clock.monotonic_s()
        self._free_s = max(self._free_s, now_s) + BITS * n_bytes / self._baud
        self.longest_wait_s = max(self.longest_wait_s, self._free_s - now_s)
        self._on_item(item)
        return True


@pytest.mark.parametrize(
    ("device", "link", "settings", "make"),
    [
        ("imc", "serial:///dev/ttyS0?baud=9600", "", FakeImc),
        ("imc", "serial:///dev/ttyS0?baud=9600", "imc: {acknowledges: true}", FakeImc),
        ("imc", "serial:///dev/ttyS0?baud=115200", "imc: {acknowledges: true}", FakeImc),
        ("iver", "serial:///dev/ttyS0?baud=4800", "", FakeIver),
        ("recon", "serial:///dev/ttyS0?baud=4800", "", FakeRecon),
        ("vehicle_can", "slcan:///dev/ttyS0?bitrate=250000&baud=9600", "", FakeCan),
    ],
)
def test_what_goes_out_waits_for_no_flood_of_contacts(
    device: str, link: str, settings: str, make: Callable[[], FakeController[Any]]
) -> None:
    clock, vehicle, answers = ManualClock(1.7e9), make(), list[Any]()
    config = config_of(f"{VEHICLE}ports: [{{name: v, link: '{link}', device: {device}, {settings}}}]")
    (port,) = read_ports(config)
    assert isinstance(port.vehicle, VehicleSettings)
    line = Line(int(link.rpartition("=")[2]), clock, lambda item: answers.extend(vehicle.heard(item, now_s())))
    source = PortSource(config, clock, lambda *_: line)  # type: ignore[arg-type]
    pilot, decoder = source.vehicle, decoder_of(device, port.vehicle, "v")
    assert pilot is not None

    def now_s() -> float:
        return clock.monotonic_s()

    def step() -> None:
        clock.advance_to(clock.utc_s() + TICK_S)
        heard = [*answers, *vehicle.tick(nav_of(clock.utc_s()), False, now_s())]
        answers.clear()
        stamp = Stamp(round(now_s() * 1e9), round(clock.utc_s() * 1e9))
        pilot.hear([message for item in heard for message in decoder.feed(item, stamp)], stamp)

    vehicle.connected(0.0)
    pilot.connected()
    for number in range(1, N_CONTACTS + 1):
        pilot.report(contact(number))
    known: set[int] = set()
    for _ in range(round(400.0 / TICK_S)):
        step()
        known |= {report.number for report in vehicle.take_reports()}
    assert line.longest_wait_s < 1.0
    if device != "imc" or settings:  # a Target bears a label, which the fake keeps apart
        assert known == set(range(1, N_CONTACTS + 1))
