"""Make cascade models of which a test states what it examines."""

from __future__ import annotations

from typing import Any

import msgspec

from auv_mcm.detect.cascade.model import Calibration, CascadeModel, Stump


def model_with(groups: tuple[tuple[Stump, ...], ...], reject: int = 0, **changes: Any) -> CascadeModel:
    """A soft cascade of these groups, each with the same threshold; changes as of CascadeModel."""
    plain = CascadeModel(
        kind="soft",
        trained_on="nothing",
        training_sha256="",
        row_spacing_m=(0.1, 0.2),
        column_spacing_m=(0.05, 0.1),
        calibration=Calibration(score=(0, 1), log_odds=(0.0, 0.0)),
        reject=(reject,) * len(groups),
        groups=groups,
    )
    return msgspec.structs.replace(plain, **changes)
