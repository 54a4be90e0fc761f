"""A request for control that the vehicle considers is waited for, and not for ever."""

from __future__ import annotations

import math
from collections import Counter

from auv_mcm.settings.vehicle_settings import CanSettings
from drivers.links.can_frame import CanFrame
from drivers.vehicle import can_messages as can
from drivers.vehicle.can_receiver import CanReceiver
from drivers.vehicle.pilot import Pilot
from drivers.vehicle.vehicles import decoder_of, talker_of
from tests.drivers.vehicle.test_pilot import HOME_DEG, TWO_LEGS, settings
from tests.drivers.vehicle.vehicle_on_paper import stamp


class SlowVehicle:
    """A vehicle on a CAN bus that answers every request with "considering", for so long."""

    def __init__(self, considers_s: float) -> None:
        self.decoder = decoder_of("vehicle_can", CanSettings(), "vehicle")
        self.pilot: Pilot[CanFrame] = Pilot(talker_of("vehicle_can", CanSettings(), lambda _: 0), settings(), session=7)
        self.numbers: dict[int, float] = {}
        self.considers_s, self.n_ticks = considers_s, 0
        self.pilot.connected(0.0)
        self.pilot.propose(TWO_LEGS, 0.0)

    def tick(self, seconds: float) -> None:
        receiver = CanReceiver("vehicle", "payload", CanSettings().payload_address, Counter())
        for _ in range(round(10.0 * seconds)):
            self.n_ticks += 1
            now_s, counter = 0.1 * self.n_ticks, self.n_ticks % 256
            noise_m = 0.01 * (self.n_ticks % 2)
            number, since_s = next(reversed(self.numbers.items()), (0, math.inf))
            grant = 0 if not number else 2 if now_s - since_s > self.considers_s else 1
            state = can.StateMessage(HOME_DEG[0], 0.0, HOME_DEG[1], 1.5, 20.0, 0.0, 8.0 + noise_m, 0.0)
            for record in (state, can.VehicleStatus(grant, 0, number, 0, 0, counter)):
                for frame in can.encode(record, 32, counter):
                    self.pilot.hear(self.decoder.feed(frame, stamp(now_s)), stamp(now_s))
            for frame in self.pilot.take_outgoing(now_s):
                said = receiver.add(frame, now_s)
                if said is not None and isinstance(said.record, can.PayloadStatus) and said.record.demand == 1:
                    self.numbers.setdefault(said.record.request_number, now_s)


def test_a_vehicle_that_considers_a_request_is_waited_for() -> None:
    vehicle = SlowVehicle(considers_s=45.0)
    vehicle.tick(60.0)
    assert vehicle.pilot.authority == "granted"
    assert len(vehicle.numbers) == 1


def test_a_person_is_asked_once_about_a_vehicle_that_never_decides() -> None:
    vehicle = SlowVehicle(considers_s=math.inf)
    vehicle.tick(400.0)
    (notice,) = vehicle.pilot.take_notices()
    assert notice.code == "vehicle_control_unanswered"
    assert "considered a request for control for 120 s" in notice.text
    assert len(vehicle.numbers) == 4
