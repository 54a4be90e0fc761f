"""Encode contact reports in IMC: Target, which every vehicle takes, and the payload's own, complete MineContact."""

from __future__ import annotations

import math
from typing import Final, get_args

from auv_mcm.records import ContactClass
from drivers.vehicle.dialect import ContactReport
from drivers.vehicle.imc_messages import MineContact, Target, ZUnits

CLASSES: Final[tuple[ContactClass, ...]] = get_args(ContactClass)
_U16, _U32 = 0xFFFF, 0xFFFFFFFF


def target_of(report: ContactReport) -> Target:
    """Encode what fits into a Target: name, place and depth."""
    known = math.isfinite(report.depth_m)
    return Target(
        label=report.label,
        lat=math.radians(report.latitude_deg),
        lon=math.radians(report.longitude_deg),
        z=report.depth_m if known else 0.0,
        z_units=ZUnits.DEPTH if known else ZUnits.NONE,
    )


def imc_contact_of(report: ContactReport) -> MineContact:
    """Encode the whole report. Session and number keep their lower 32 bits, revision and views 16."""
    masses = {f"belief_{name}": report.belief.get(name, 0.0) for name in CLASSES}
    return MineContact(
        session=report.session & _U32,
        number=report.number & _U32,
        revision=report.revision & _U16,
        time=report.time_s,
        lat=math.radians(report.latitude_deg),
        lon=math.radians(report.longitude_deg),
        sigma=report.sigma_m,
        depth=report.depth_m,
        p_mine=report.p_mine,
        classification=CLASSES.index(report.classification),
        views=min(report.n_views, _U16),
        length=report.length_m,
        width=report.width_m,
        height=report.height_m,
        length_sigma=report.length_sigma_m,
        width_sigma=report.width_sigma_m,
        height_sigma=report.height_sigma_m,
        **masses,
    )


def report_from_imc(contact: MineContact) -> ContactReport:
    """Decode a message to a report. Raises ValueError for an unknown class."""
    if contact.classification >= len(CLASSES):
        raise ValueError(f"class {contact.classification} is not one of {', '.join(CLASSES)}")
    return ContactReport(
        session=contact.session,
        number=contact.number,
        revision=contact.revision,
        time_s=contact.time,
        latitude_deg=math.degrees(contact.lat),
        longitude_deg=math.degrees(contact.lon),
        sigma_m=contact.sigma,
        p_mine=contact.p_mine,
        classification=CLASSES[contact.classification],
        belief={name: getattr(contact, f"belief_{name}") for name in CLASSES},
        n_views=contact.views,
        depth_m=contact.depth,
        length_m=contact.length,
        width_m=contact.width,
        height_m=contact.height,
        length_sigma_m=contact.length_sigma,
        width_sigma_m=contact.width_sigma,
        height_sigma_m=contact.height_sigma,
    )
