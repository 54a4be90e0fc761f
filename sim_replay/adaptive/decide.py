"""Decide the legs of a flight by the payload's planner."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import msgspec
import numpy as np

from auv_mcm.clearance.clearance_map import LookModel
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.plan.clear_area import wished
from auv_mcm.plan.limits import Limits
from auv_mcm.plan.survey import Plan, SurveyState, replan
from sim_replay.adaptive.flight import Decide, LegDecision, Situation
from sim_replay.adaptive.order import Order
from sim_replay.simulator.plan import Leg

_STEPS: Final = 300  # of the planner's search: counted, so that the same mission gives the same plans on any machine
_FENCE_MARGIN_M: Final = 5.0  # m that legs keep from the fence


def by_replanning(order: Order, model: LookModel, limits: Limits, origin: LocalFrame) -> Decide:
    """Plan anew at each call, keeping to the plan before. origin: the plane of the order's fence."""
    previous: Plan | None = None
    plane: LocalFrame | None = None

    def decide(now: Situation) -> LegDecision:
        nonlocal previous, plane
        here = LocalFrame(latitude_deg=now.ground.origin_latitude_deg, longitude_deg=now.ground.origin_longitude_deg)
        corner = here.to_enu(origin.latitude_deg, origin.longitude_deg, 0.0)[:2]
        kept = previous if here == plane else None
        world = SurveyState(
            clearance=now.ground,
            area=np.ones(now.ground.looks.shape, dtype=bool),
            required=wished(now.required),
            performance=model,
            contacts=(),
            mean_required=now.required,
        )
        there = limits._replace(fence=order.fence + corner, fence_margin_m=_FENCE_MARGIN_M, budget_m=now.left_m)
        plan = replan(world, now.pose, there, kept, _counted(_STEPS))
        # Its first leg will lie behind, and may be worth flying again, but not for having been planned.
        previous, plane = msgspec.structs.replace(plan, legs=plan.legs[1:]), here
        legs = tuple(
            Leg(
                leg.entry.east_m,
                leg.entry.north_m,
                leg.entry.heading_rad,
                float(np.hypot(*np.subtract(leg.exit[:2], leg.entry[:2]))),
            )
            for leg in plan.legs
        )
        return LegDecision(legs, plan.verdict, "; ".join(leg.why for leg in plan.legs[:1]) or plan.verdict)

    return decide


def _counted(steps: int) -> Callable[[], bool]:
    left = iter(range(steps))
    return lambda: next(left, None) is not None
