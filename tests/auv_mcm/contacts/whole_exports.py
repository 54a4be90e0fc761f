"""Exports in one piece, in the order in which results are written."""

from __future__ import annotations

from collections.abc import Iterable

from auv_mcm.contacts.export import (
    contact_order,
    contacts_csv_parts,
    contacts_kml_parts,
    coverage_geojson_parts,
    coverage_order,
)
from auv_mcm.records import Contact, CoveragePatch


def coverage_geojson(patches: Iterable[CoveragePatch]) -> bytes:
    return b"".join(coverage_geojson_parts(sorted(patches, key=coverage_order)))


def contacts_csv(contacts: Iterable[Contact]) -> str:
    return "".join(contacts_csv_parts(sorted(contacts, key=contact_order)))


def contacts_kml(contacts: Iterable[Contact], mission: str = "") -> str:
    return "".join(contacts_kml_parts(sorted(contacts, key=contact_order), mission))
