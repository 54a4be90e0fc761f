"""Choose which IMC vehicle to follow, and whether it may be asked for control."""

from __future__ import annotations

import math
from typing import Final

from drivers.vehicle import imc_messages as imc
from drivers.vehicle.imc_messages import ImcMessage, OpMode, PlanState, RefState
from drivers.vehicle.imc_wire import ANYONE

PLAN_ID: Final = "auv_mcm"
"""Name of the payload's plan."""

VEHICLE_TYPES: Final = frozenset({2, 3})  # Announce.sys_type: under water, on the surface
_ANOTHER_AFTER_S: Final = 60.0  # s of silence of a vehicle that is not named, until another takes its place; chosen
_PLANS_VALID_S: Final = 3.0  # s that a report of plans counts; they come every second
_ABORTS_S: Final = 2.0  # s after an Abort in which a report may still be of the plan that it ends
_SUCCESS: Final = 1  # PlanControlState.last_outcome: ended by itself
_IDLE: Final = "the vehicle flies no plan"
_MAX_HEARD: Final = 4  # vehicles named in a doubt: two suffice for it, and anybody may send thousands


class FollowedVehicle:
    """Choose whom to follow: the vehicle that is named, or the first one heard until it is silent and another speaks.

    number: its IMC address, None before it is heard.
    """

    def __init__(self, named: int, payload: int | None = None) -> None:
        """named: the address configured, 0 for none. payload: our own, if it starts a plan of its own."""
        self._named = named or None
        self._payload = payload
        self._all: dict[int, None] = {}  # vehicles heard, where none is named
        self._aborted_s = -math.inf
        self._withheld = ""  # why it is not asked, until it flies a plan of its own
        self._flew = self._flies_ours = self._flies_own = False  # any plan was reported to run; which one runs
        self._plan_before = self._sent_on = ""  # plans of the vehicle: before the payload's, and in its place
        self.is_left = False  # by the payload, which ends its own plan
        self.restart()

    def restart(self) -> None:
        """Forget whom to follow, as on a wire that was opened again."""
        self.number, self._heard_s, self._plans_s = self._named, -math.inf, -math.inf
        self._leader, self._led_s = 0, -math.inf  # another payload that the vehicle follows

    def hear(self, source: int, message: ImcMessage, now_s: float, to: int = ANYONE) -> None:
        """Take a message of any source but the payload. to: whom it is addressed to."""
        if isinstance(message, imc.Abort) and to in (ANYONE, self.number):
            self._aborted_s, self._withheld = now_s, "an Abort came"
        if self._named is None and is_vehicle(message):
            if len(self._all) < _MAX_HEARD:
                self._all[source] = None
            if now_s - self._heard_s > _ANOTHER_AFTER_S:
                self.number = source
        if source == self.number:
            self._heard_s = now_s

    def hear_plan(self, message: ImcMessage, now_s: float, *, is_recent: bool) -> None:
        """Find out from the vehicle's message whether it may be started: it flies, or is idle since the payload's plan.

        is_recent: by its time. What would let it be started counts only then.
        """
        if isinstance(message, imc.FollowRefState):
            is_over = message.state == RefState.TIMEOUT
            self._flies_ours &= not is_over
            is_led = self._payload is not None and message.control_src != self._payload and not is_over
            self._leader, self._led_s = message.control_src, now_s if is_led else -math.inf
        if isinstance(message, imc.VehicleState) and message.op_mode == OpMode.EXTERNAL:
            self._withheld = "the vehicle was under external control"
        elif isinstance(message, imc.VehicleState) and message.op_mode == OpMode.BOOT:
            self._flew = False
        if not isinstance(message, imc.PlanControlState):
            return
        self._plans_s = now_s if is_recent else self._plans_s
        if message.state not in (PlanState.INITIALIZING, PlanState.EXECUTING):
            flew_ours = self._flies_ours and not self.is_left
            is_done = message.state == PlanState.READY and message.last_outcome == _SUCCESS
            if (flew_ours or self._flies_own) and not is_done:
                whose = "payload" if flew_ours else "vehicle"
                self._withheld = self._withheld or f"the {whose}'s plan was stopped on board"
            elif not self._flew:
                self._withheld = self._withheld or _IDLE
            self._flies_ours = self._flies_own = False
        elif not is_recent:
            return
        elif message.plan_id == PLAN_ID:
            self._flew, self._flies_ours, self._flies_own = True, True, False
            self._withheld = self._withheld if self._withheld != _IDLE else ""
        elif message.state == PlanState.EXECUTING and now_s - self._aborted_s >= _ABORTS_S:
            self._take_own_plan(message.plan_id)

    def _take_own_plan(self, plan_id: str) -> None:
        """Take the plan of its own that the vehicle flies; one that took the place of the payload's is left alone."""
        if self._flies_ours and not self.is_left and self._plan_before not in ("", plan_id):
            self._sent_on = plan_id
        if plan_id == self._sent_on:
            self._withheld = f"the vehicle was sent on plan {plan_id} instead"
        else:
            self._withheld = self._sent_on = ""
            self._plan_before = plan_id
        self._flew, self._flies_ours, self._flies_own = True, False, True

    def may_be_asked(self, now_s: float) -> bool:
        """Check whether a vehicle is known that may be asked for control, by what it reported just now."""
        return self.number is not None and not self.why_not(math.inf, now_s) and self._plans_are_known(now_s)

    def why_not(self, due_s: float, now_s: float) -> str:
        """Say why the vehicle is not asked for control, "" where it may be. due_s: when it was to be asked."""
        if self.doubt or self._withheld:
            again = f"control is requested once it flies {'another' if self._sent_on else 'a plan of its own'}"
            return self.doubt or f"{self._withheld}: {again}"
        if now_s - self._led_s <= _PLANS_VALID_S:
            return f"the vehicle follows 0x{self._leader:04X}"
        is_silent = self.number is not None and now_s - due_s > _PLANS_VALID_S and not self._plans_are_known(now_s)
        return "the vehicle does not report its plans (PlanControlState)" if is_silent else ""

    def _plans_are_known(self, now_s: float) -> bool:
        """Check for a report on this wire; an older one does not show that a person has stopped the vehicle since."""
        return now_s - self._plans_s <= _PLANS_VALID_S

    @property
    def doubt(self) -> str:
        """Say why none of several vehicles is asked for control, "" where it is clear whom to ask."""
        if len(self._all) < 2:
            return ""
        heard = " and ".join(f"0x{number:04X} ({number})" for number in self._all)
        return (
            f"vehicles {heard} are heard, and imc.vehicle_id names none: one is followed until silent for "
            f"{_ANOTHER_AFTER_S:g} s, none is asked for control. Set vehicle_id to the one that carries the payload."
        )


def is_vehicle(message: ImcMessage) -> bool:
    """Check whether only a vehicle sends this message."""
    return isinstance(message, imc.EstimatedState) or (
        isinstance(message, imc.Announce) and message.sys_type in VEHICLE_TYPES
    )
