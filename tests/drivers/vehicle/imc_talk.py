"""Talk as an IMC vehicle with the payload's dialect."""

from __future__ import annotations

import math
from typing import Any

from auv_mcm.clock import Stamp
from auv_mcm.settings.vehicle_settings import ImcSettings
from drivers.framing import Framer
from drivers.vehicle import imc_messages as imc
from drivers.vehicle.decoders.imc_followed import PLAN_ID
from drivers.vehicle.dialect import GoTo, Granted, VehicleEvent, Vertical
from drivers.vehicle.imc_codec import decode
from drivers.vehicle.imc_messages import ImcMessage, PlanOp, PlanState, PlanType, Proximity, RefFlag, RefState
from drivers.vehicle.imc_wire import ANYONE, ImcGrammar, ImcPacket, packed
from tests.sim_replay.conversation import Conversation

US, VEHICLE, OTHER = 0x6000, 0x1E, 0x2F
UTC_S = 1_700_000_000
GOAL = GoTo(41.1851, -8.7062, Vertical("altitude", 5.0), 1.5, 3.0)
LEARNS, KNOWS, INVITED = (
    ImcSettings(),
    ImcSettings(vehicle_id=VEHICLE, acknowledges=True),
    ImcSettings(vehicle_id=VEHICLE, own_plan=False),
)
SURVEY = imc.PlanControlState(PlanState.EXECUTING, "survey")


class Talk:
    """Run a dialect whose wire is open, and collect its messages.

    plans: what the vehicle reports of its plans at first; it reports the same again before it is asked.
    """

    def __init__(
        self, settings: ImcSettings = KNOWS, now_s: float = 100.0, plans: imc.PlanControlState = SURVEY
    ) -> None:
        self.dialect = Conversation(settings)
        self.now_s = now_s
        self.plans = plans
        self.dialect.connected(now_s)
        self.sent()
        if settings.vehicle_id:
            self.hear(plans)

    def packets(self) -> list[ImcPacket]:
        framer = Framer(ImcGrammar())
        return [framed.message for item in self.dialect.take_outgoing(self.now_s) for framed in framer.feed(item)]

    def sent(self) -> list[ImcMessage]:
        return [decode(packet.number, packet.payload) for packet in self.packets()]

    def sent_of(self, kind: type[Any], for_s: float = 0.0) -> list[Any]:
        """All of a kind within the next seconds, nothing being heard."""
        until_s = self.now_s + for_s
        found = [message for message in self.sent() if type(message) is kind]
        while self.now_s < until_s - 1e-6:
            self.now_s += 0.1
            found += [message for message in self.sent() if type(message) is kind]
        return found

    def hear(
        self, *messages: ImcMessage, source: int = VEHICLE, to: int = ANYONE, age_s: float = 0.0
    ) -> list[VehicleEvent]:
        """age_s: of their times, by the sender's clock, which is an hour off."""
        if source == VEHICLE:
            self.plans = next((each for each in messages[::-1] if isinstance(each, imc.PlanControlState)), self.plans)
        time_s = UTC_S + 3600.0 + self.now_s - age_s
        data = b"".join(packed(message, source, to=to, time_s=time_s) for message in messages)
        return self.dialect.hear(data, stamp_at(self.now_s))

    def ask(self) -> int:
        """Ask for control; returns the number of the request."""
        self.dialect.request(self.now_s)
        (start,) = self.sent_of(imc.PlanControl)
        assert start.op == PlanOp.START
        return int(start.request_id)

    def take_over(self) -> None:
        """Ask for control and get it."""
        self.hear(self.plans)
        number = self.ask()
        assert self.hear(succeeded(number)) == []
        assert [type(event) for event in self.hear(follow_state())] == [Granted]


def stamp_at(now_s: float) -> Stamp:
    return Stamp(round(1e9 * now_s), round(1e9 * (UTC_S + now_s)))


def succeeded(request_id: int) -> imc.PlanControl:
    return imc.PlanControl(PlanType.SUCCESS, PlanOp.START, request_id, PLAN_ID)


def follow_state(
    goal: GoTo | None = None, state: int = RefState.WAIT, near: int = Proximity.FAR, of: int = US
) -> imc.FollowRefState:
    reference = goal and imc.Reference(
        RefFlag.LOCATION, lat=math.radians(goal.latitude_deg), lon=math.radians(goal.longitude_deg)
    )
    return imc.FollowRefState(of, 255, reference, state, near)


def estimated(latitude_deg: float, longitude_deg: float, **others: float) -> imc.EstimatedState:
    return imc.EstimatedState(math.radians(latitude_deg), math.radians(longitude_deg), **others)
