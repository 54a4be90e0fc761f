"""Contacts, detections, confirmations and what their steps measured, made up: only what a test names is particular
about them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import vacuous
from auv_mcm.classify.evidence import ClassEvidence, view_mass
from auv_mcm.classify.fit import ShapeFits
from auv_mcm.classify.odds import with_ratio
from auv_mcm.confirm.region import Region
from auv_mcm.confirm.snake import Contours
from auv_mcm.records import NAN, Confirmation, Contact, ContactClass, Detection

NOWHERE = np.empty((0, 2))


def detection(**values: Any) -> Detection:
    known: dict[str, Any] = {
        "side": "starboard",
        "row": 100.0,
        "column": 200.0,
        "time_s": 0.0,
        "ping_number": 100,
        "latitude_deg": 43.0,
        "longitude_deg": 10.0,
        "covariance_m2": np.eye(2),
        "heading_rad": 0.0,
        "aspect_deg": 90.0,
        "ground_range_m": 12.0,
        "slant_range_m": 13.0,
        "altitude_m": 5.0,
        "score": 6.0,
        "highlight_db": 8.0,
        "shadow_db": -8.0,
        "length_m": 1.0,
        "width_m": 0.5,
        "height_m": 0.4,
        "shadow_length_m": 1.0,
        "p_mine": 0.7,
        "reasons": (),
        "snippet": np.zeros((1, 1), dtype=np.uint8),
        "snippet_row": 0.5,
        "snippet_column": 0.5,
        "row_spacing_m": 0.12,
        "column_spacing_m": 0.06,
    }
    return Detection(**{**known, **values})


def contact(**values: Any) -> Contact:
    known: dict[str, Any] = {
        "id": "C00001",
        "time_s": 0.0,
        "latitude_deg": 43.0,
        "longitude_deg": 10.0,
        "covariance_m2": np.eye(2),
        "p_mine": 0.9,
        "classification": "unknown",
        "belief": {"unknown": 1.0},
        "length_m": 1.0,
        "width_m": 0.5,
        "height_m": NAN,
        "aspects_deg": (),
        "reasons": (),
        "views": (),
    }
    return Contact(**{**known, **values})


def like(*names: ContactClass, quality: float = 0.95) -> NDArray[np.float64]:
    """(32,) mass of a view that shows these solids equally well and no other."""
    solids: tuple[ContactClass, ...] = ("cylinder", "sphere", "truncated_cone", "wedge")
    evidence: Mapping[ContactClass, ClassEvidence] = {
        name: ClassEvidence(nll=0.0 if name in names else 400.0) for name in solids
    }
    return view_mass(evidence, quality)


def confirmation(log_ratio: float, shape_mass: NDArray[np.float64] | None = None, **values: Any) -> Confirmation:
    shape = vacuous() if shape_mass is None else shape_mass
    known: dict[str, Any] = {
        "log_ratio": log_ratio,
        "shape_mass": shape,
        "mass": with_ratio(shape, log_ratio),
        "half_turn_symmetric": True,
        "labels": np.zeros((0, 0), dtype=np.uint8),
        "highlight": NOWHERE,
        "shadow": NOWHERE,
        "model": None,
        "rejected": False,
        "reasons": (),
    }
    return Confirmation(**{**known, **values})


def no_contours(**values: Any) -> Contours:
    known: dict[str, Any] = {
        "highlight": NOWHERE,
        "shadow": NOWHERE,
        "criterion": NAN,
        "gain": NAN,
        "n_moves": 0,
        "highlight_mean": NAN,
        "shadow_mean": NAN,
        "background_mean": NAN,
        "highlight_area_m2": 0.0,
        "length_m": 0.0,
        "height_m": NAN,
        "repetition": NAN,
        "reasons": (),
        "rejected": True,
    }
    return Contours(**{**known, **values})


def no_fits(**values: Any) -> ShapeFits:
    known: dict[str, Any] = {"fits": (), "contour_cost": None, "n_hypotheses": 0, "flags": ()}
    return ShapeFits(**{**known, **values})


def bare_floor(n_rows: int = 40, n_columns: int = 60) -> Region:
    return Region(
        intensity=np.ones((n_rows, n_columns)),
        valid=np.ones((n_rows, n_columns), dtype=np.bool_),
        row_spacing_m=0.1,
        column_spacing_m=0.05,
        first_ground_range_m=10.0,
        altitude_m=5.0,
        row=20.0,
        column=20.0,
        beam_width_rad=0.01,
    )
