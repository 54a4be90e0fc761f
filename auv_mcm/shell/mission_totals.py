"""Sum up a mission for summary.json: contacts, the search and the area to be cleared, and its notices."""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np

from auv_mcm.classify.beliefs import MINE_LIKE_P
from auv_mcm.clearance.area import area_state, over_area
from auv_mcm.clearance.clearance_export import BANDS
from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.clearance.residual import PRIOR_SHARE, remaining_mines
from auv_mcm.contacts.contact import is_mine_like
from auv_mcm.contacts.expected_alarms import MINE_LIKE_NATS
from auv_mcm.contacts.operating_point import OperatingPoint
from auv_mcm.detect.belief import odds_of, probability
from auv_mcm.records import SEABED_TYPES, Contact, CoveragePatch, Notice
from auv_mcm.settings.plan_settings import PlanConfig


def contact_totals(contacts: Iterable[Contact], coverage: Iterable[CoveragePatch]) -> dict[str, Any]:
    """Count contacts, and sum the covered area over tiles.

    Sea floor passed twice counts twice; sub-apertures of one pass count once.
    """
    covered_m2 = math.fsum(patch.covered_m2 for patch in _of_one_squint(coverage))
    counted: Counter[str] = Counter()
    for contact in contacts:
        counted.update(
            contacts=1, contacts_mine_like=int(is_mine_like(contact)), contacts_called=int(bool(contact.called))
        )
    return {
        "covered_km2": round(covered_m2 / 1e6, 6),
        **{name: counted[name] for name in ("contacts", "contacts_mine_like", "contacts_called")},
    }


def _of_one_squint(coverage: Iterable[CoveragePatch]) -> Iterable[CoveragePatch]:
    """Leave out patches whose side was looked at during their time by another squint already."""
    seen: dict[str, dict[float, list[tuple[float, float]]]] = {}  # start and stop by side and squint, by time
    longest_s = 0.0
    for patch in coverage:
        by_squint, start_s, stop_s = seen.setdefault(patch.side, {}), patch.start_s, patch.stop_s
        before = (
            spans[bisect_left(spans, (start_s - longest_s,)) : bisect_left(spans, (stop_s,))]
            for squint, spans in by_squint.items()
            if squint != patch.squint_rad
        )
        if any(other_s < stop_s and start_s < until_s for spans in before for other_s, until_s in spans):
            continue
        if start_s <= stop_s:
            insort(by_squint.setdefault(patch.squint_rad, []), (start_s, stop_s))
            longest_s = max(longest_s, stop_s - start_s)
        yield patch


def point_totals(point: OperatingPoint | None) -> dict[str, Any]:
    """State the operating point.

    What was asked, from which p_mine on that calls, and the false alarms that are expected.

    called_from_p_mine: None where nothing is called. expected_per_km2: false alarms among what is called, with the 95 %
    interval. background_per_km2: false alarms expected among contacts that reach a p_mine. area_too_small: what was
    searched allows fewer than one false alarm.
    """
    if point is None:
        return {}
    level = point.level_nats
    from_p_mine = MINE_LIKE_P if level == MINE_LIKE_NATS else round(probability(level), 6)  # as files write p_mine
    totals: dict[str, Any] = {
        "asked_per_km2": point.asked_per_km2,
        "called_from_p_mine": None if level == math.inf else from_p_mine,
        "contacts_counted": point.n_contacts,
        "searched_km2": round(point.area_km2, 6),
        "area_too_small": point.is_short,
    }
    if point.expected is not None:
        expected = point.expected.reaching(level)
        totals["expected_per_km2"] = {
            name: round(value, 3) for name, value in zip(("middle", "low", "high"), expected, strict=True)
        }
        totals["background_per_km2"] = {
            f"{p:g}": round(point.expected.reaching(odds_of(p)).per_km2, 3) for p in (0.02, 0.1, 0.2, 0.5, 0.8)
        }
    return {"operating_point": totals}


def search_totals(clearance: Clearance | None, contacts: Iterable[Contact]) -> dict[str, Any]:
    """Sum up the search over all that was seen; empty if there is none.

    Of a cell counts what was seen of it. share_missed: of mines that lie there, by the tables, whatever their density.
    mines_found: the sum of p_mine of contacts called mine-like. mines_left: see `remaining_mines`.
    """
    if clearance is None:
        return {}
    seen = clearance.seen
    p, kind = clearance.p_detected[seen], clearance.seabed[seen]
    cell_m2 = clearance.cell_m**2
    seen_km2 = clearance.share[seen].astype(np.float64) * cell_m2 * 1e-6
    p_mean = float(p.sum()) * cell_m2 * 1e-6 / (float(seen_km2.sum()) or 1.0)
    judged = [(contact.p_mine, is_mine_like(contact)) for contact in contacts]
    p_mine = np.array([p_mine for p_mine, _ in judged], dtype=np.float64)
    mine_like = np.array([is_one for _, is_one in judged], dtype=np.bool_)
    left = remaining_mines(p_mine, mine_like, p)
    return {
        "searched": {
            "km2": round(float(seen_km2.sum()), 6),
            "p_detected_mean": round(p_mean, 4),
            "share_missed": round(1.0 - p_mean, 4),
            "km2_elsewhere": round(clearance.n_elsewhere * cell_m2 * 1e-6, 6),
            "km2_at_p": {f"{low:g}": round(float(seen_km2[p >= low].sum()), 6) for low in BANDS[1:-1]},
            "seabed_km2": {
                name: round(float(seen_km2[kind == index].sum()), 6) for index, name in enumerate(SEABED_TYPES)
            },
            "mines_found": round(math.fsum(p_mine[mine_like]), 4),
            "mines_left": {
                "expected": round(left.expected, 4),
                "at_most_95": left.at_most_95,
                "p_none": round(left.p_none, 4),
                "among_contacts": int(np.count_nonzero(~mine_like)),
                "p_mine_sum": round(math.fsum(p_mine[~mine_like]), 4),
                "mine_share": round(left.share, 4),
                "mine_share_presumed": PRIOR_SHARE,
            },
        }
    }


def area_totals(clearance: Clearance | None, plan: PlanConfig, verdict: str = "") -> dict[str, Any]:
    """State how the search of the area to be cleared stands at the end; empty if there is no area.

    verdict: of planning, while it went on.
    """
    if not plan.area_deg:
        return {}
    state = area_state(over_area(clearance, plan.area_deg, plan.cell_m), plan.required_clearance)
    return {
        "area": {
            "km2": round(state.km2, 6),
            "required": state.required,
            "p_detected_mean": round(state.p_detected, 4),
            "percent_at_required": round(100.0 * state.share, 1),
            "reached": state.is_reached,
            "verdict": verdict,
        }
    }


def notice_lists(notices: Iterable[Notice]) -> dict[str, list[dict[str, str]]]:
    """List `notices`, which ask a person to do something, apart from `remarks`, which are for the record."""
    lists: dict[str, list[dict[str, str]]] = {"notices": [], "remarks": []}
    for notice in notices:
        fields = {"code": notice.code, "text": notice.text, "place": notice.place}
        lists["remarks" if notice.for_the_record else "notices"].append(fields)
    return lists


def clearance_notices(clearance: Clearance | None) -> list[Notice]:
    """Raise notices about the map of clearance."""
    if clearance is None or not clearance.n_elsewhere:
        return []
    text = (
        f"{clearance.n_elsewhere * clearance.cell_m**2 * 1e-6:.3g} km² were searched too far from the rest to be in "
        "the clearance map and in the figures of the search. Check the positions in coverage.geojson; replay separate "
        "sites apart, or raise plan.cell_m."
    )
    return [Notice(code="clearance.elsewhere", text=text)]
