"""A payload that may not command leaves control of others alone; one that may ends what a run before left behind."""

from __future__ import annotations

from typing import Any

import pytest

from auv_mcm.clock import Stamp
from drivers.port_source import PortSource
from drivers.ports import read_ports
from drivers.vehicle import imc_messages as imc
from drivers.vehicle.decoders.imc_followed import PLAN_ID
from drivers.vehicle.imc_messages import PlanState
from drivers.vehicle.imc_wire import packed
from drivers.vehicle.vehicles import VehicleSettings, decoder_of
from tests.drivers.port_traffic import config_of
from tests.drivers.test_port_source_vehicle import VEHICLE
from tests.drivers.vehicle.imc_talk import VEHICLE as SENDER
from tests.drivers.vehicle.test_recon import state
from tests.manual_clock import ManualClock

OURS = packed(imc.PlanControlState(PlanState.EXECUTING, PLAN_ID), SENDER)
OVERRIDE_IS_ACTIVE = state(0x0D)


class Link:
    """Fake the link of a port, and keep what is written."""

    place, state = "line", "up"

    def __init__(self) -> None:
        self.written: list[Any] = []

    def write(self, item: Any) -> bool:
        self.written.append(item)
        return True


@pytest.mark.parametrize("command", [True, False])
@pytest.mark.parametrize(
    ("device", "said", "ends"), [("recon", OVERRIDE_IS_ACTIVE, b"#E,0"), ("imc", OURS, PLAN_ID.encode())]
)
def test_control_of_another_payload_is_ended_by_one_that_may_command_alone(
    device: str, said: bytes, ends: bytes, command: bool
) -> None:
    text = VEHICLE if command else ""
    settings = f"imc: {{vehicle_id: {SENDER}}}" if device == "imc" else ""
    config = config_of(f"{text}ports: [{{name: v, link: 'tcp://10.0.0.2:1', device: {device}, {settings}}}]")
    (port,) = read_ports(config)
    assert isinstance(port.vehicle, VehicleSettings)
    clock, link = ManualClock(1.7e9), Link()
    pilot, decoder = PortSource(config, clock, lambda *_: link).vehicle, decoder_of(device, port.vehicle, "v")  # type: ignore[arg-type]
    assert pilot is not None
    pilot.connected()
    for _ in range(10):
        clock.advance_to(clock.utc_s() + 1.0)
        stamp = Stamp(round(clock.monotonic_s() * 1e9), round(clock.utc_s() * 1e9))
        pilot.hear(decoder.feed(said, stamp), stamp)
    assert pilot.authority != "down"
    assert any(ends in item for item in link.written) == command
