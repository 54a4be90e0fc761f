"""Missions to score: objects and contacts placed in metres east and north of one point, as files or records."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from auv_mcm.geometry.geodesy import LocalFrame
from sim_replay.scoring import ScoredMission, parse_contacts, parse_truth

FRAME = LocalFrame(latitude_deg=43.1, longitude_deg=5.9)


def contact(
    east_m: float, north_m: float, p_mine: float = 0.9, named: str | None = None, **properties: Any
) -> dict[str, Any]:
    latitude, longitude, _ = FRAME.to_geodetic([east_m, north_m, 0.0])
    return {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": [float(longitude), float(latitude)]},
        "properties": {"p_mine": p_mine, **({"class": named} if named else {}), **properties},
    }


def truth_object(
    east_m: float, north_m: float, kind: str = "cylinder", *, is_target: bool = True, **facts: Any
) -> dict[str, Any]:
    latitude, longitude, _ = FRAME.to_geodetic([east_m, north_m, 0.0])
    return {"kind": kind, "lat": float(latitude), "lon": float(longitude), "is_target": is_target, **facts}


def rock(east_m: float, north_m: float, **facts: Any) -> dict[str, Any]:
    return truth_object(east_m, north_m, "rock", is_target=False, **facts)


def collection(contacts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    return {"type": "FeatureCollection", "features": list(contacts)}


def mission(
    contacts: Sequence[dict[str, Any]], objects: Sequence[dict[str, Any]], *, area_km2: float = 0.1, **truth: Any
) -> ScoredMission:
    return ScoredMission(
        parse_contacts(collection(contacts), "contacts.geojson"),
        parse_truth({"area_km2": area_km2, "objects": list(objects), **truth}, "truth.json"),
    )


def random_mission(seed: int, n_objects: int = 30, extent_m: float = 300.0) -> ScoredMission:
    """Targets and rocks that are mostly found, some twice, and false alarms between them."""
    random = np.random.Generator(np.random.PCG64(seed))
    objects, contacts = [], []
    for east_m, north_m in random.uniform(0.0, extent_m, (n_objects, 2)).tolist():
        is_target = random.random() < 0.7
        kind = str(random.choice(["cylinder", "sphere", "truncated_cone"])) if is_target else "rock"
        length_m, range_m = float(random.uniform(0.5, 2.0)), float(random.uniform(4.0, 60.0))
        sizes: dict[str, Any] = {"length_m": length_m, "width_m": 0.5, "height_m": 0.5}
        looks = [{"side": "port", "ground_range_m": range_m, "time": "2024-05-01T10:00:00Z"}] * int(
            random.random() < 0.95
        )
        objects.append(truth_object(east_m, north_m, kind, is_target=is_target, looks=looks, burial_m=0.1, **sizes))
        if random.random() < 0.9:
            for _ in range(1 + (random.random() < 0.1)):
                east_error_m, north_error_m = random.normal(0.1, 0.4, 2).tolist()
                reported: dict[str, Any] = {
                    "length_m": length_m * float(random.uniform(0.9, 1.2)),
                    "width_m": 0.6,
                    "height_m": 0.42,
                }
                p_mine = round(float(random.beta(4.0, 1.5) if is_target else random.beta(1.5, 2.0)), 4)
                named = kind if is_target else "clutter"
                reported |= {"sigma_m": 0.5, "ground_range_m": range_m}
                contacts.append(contact(east_m + east_error_m, north_m + north_error_m, p_mine, named, **reported))
    for east_m, north_m in random.uniform(0.0, extent_m, (20, 2)).tolist():
        p_mine = round(float(random.beta(1.0, 4.0)), 4)
        contacts.append(contact(east_m, north_m, p_mine, ground_range_m=float(random.uniform(4.0, 60.0))))
    return mission(contacts, objects, area_km2=extent_m**2 / 1e6)


def write_pair(folder: Path, contacts: Sequence[dict[str, Any]], truth: dict[str, Any], name: str = "m") -> list[Path]:
    paths = [folder / f"{name}.contacts.geojson", folder / f"{name}.truth.json"]
    for path, document in zip(paths, (collection(contacts), truth), strict=True):
        path.write_text(json.dumps(document), "utf-8")
    return paths
