"""Read the models that the chain decides by, as the configuration names them."""

from __future__ import annotations

from typing import NamedTuple

from auv_mcm.classify.odds import MineOdds, configured_odds
from auv_mcm.classify.size_evidence import SizeEvidence, size_evidence
from auv_mcm.classify.targets import configured_targets
from auv_mcm.contacts.background import BackgroundPrior, configured_background
from auv_mcm.detect.cascade.choose import configured_model, fitting
from auv_mcm.detect.cascade.model import CascadeModel, rejecting_last
from auv_mcm.detect.gate import Gate, configured_gate
from auv_mcm.records import Detector, Notice
from auv_mcm.settings.config import Config
from auv_mcm.skips import NO_SKIPS, Skips


class ChainModels(NamedTuple):
    """Hold the models of a mission; None for those that it goes without."""

    model: CascadeModel | None
    gate: Gate | None
    odds: MineOdds
    background: BackgroundPrior | None
    sizes: SizeEvidence


def read_models(config: Config, without_skips: Skips = NO_SKIPS) -> tuple[ChainModels, Notice]:
    """Read the models that a configuration names; returns them, and which detector serves.

    Raises BadInputError or UsageError for one that cannot be read.
    """
    model, notice = fitting(configured_model(config), config)
    detector: Detector = "contrast" if model is None else "cascade"
    odds = configured_odds(config, detector)
    sizes = size_evidence(configured_targets(config.confirm.targets))
    # The gate forecasts what confirmation says, and backgrounds are known in log-odds that it ends with.
    gate = configured_gate(config.detect.gate) if config.confirm.enabled else None
    background = configured_background(config.contacts.background, detector) if config.confirm.enabled else None
    change = odds.recalibrated
    if gate is not None and change is not None:
        gate = gate.recalibrated(change.slope, change.offset_nats)
    if background is not None and change is not None:
        background = background.recalibrated(change.slope, change.offset_nats, change.background_nats)
    if model is not None and "cascade-rejection" in without_skips:
        model = rejecting_last(model)
    return ChainModels(model, gate, odds, background, sizes), notice
