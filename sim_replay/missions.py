"""Name the missions that rates are taken on, and configure the payload for them."""

from __future__ import annotations

import math
from typing import Final

import msgspec

from auv_mcm.model_file import NONE, SHIPPED
from auv_mcm.records import Detector
from auv_mcm.settings.config import Config
from sim_replay.simulator.scene import Scene

_USUAL: Final = Config()
SCENES: Final = ("flat", "ripple", "mixed", "rough", "boulders", "seagrass", "slope", "shallow", "deep", "sas")
HELD_OUT: Final = frozenset({"seagrass"})
"""Scenes whose sea floor neither the trained detector nor the odds of its detections were fitted on."""
FIRST_SEED: Final = 9100  # seeds from here on were not used to choose scenes or constants


def config_for(scene: Scene, config: Config = _USUAL) -> Config:
    """Configure the payload with what an operator knows of the scene's sonar: its beam width.

    For a synthetic aperture that is the angle of its along-track resolution at half range.
    """
    sonar = scene.sonar
    width_deg = sonar.beam_width_deg
    if sonar.synthetic_aperture is not None:
        width_deg = math.degrees(sonar.synthetic_aperture.along_track_resolution_m / (0.5 * sonar.range_m))
    return msgspec.structs.replace(config, sonar=msgspec.structs.replace(config.sonar, beam_width_deg=width_deg))


def served_by(detector: Detector, config: Config) -> Config:
    """Choose one of the two detectors, with the odds that ship where it is not the one configured."""
    configured: Detector = "contrast" if config.detect.model == NONE else "cascade"
    if detector == configured:
        return config
    return msgspec.structs.replace(
        config,
        detect=msgspec.structs.replace(config.detect, model=SHIPPED if detector == "cascade" else NONE),
        confirm=msgspec.structs.replace(config.confirm, odds=SHIPPED),
    )


def reporting_everything(config: Config) -> Config:
    """Report contacts whatever their p_mine, so that nothing is dropped unmeasured."""
    return msgspec.structs.replace(config, contacts=msgspec.structs.replace(config.contacts, min_p_mine=0.0))


def unconfirmed(config: Config) -> Config:
    """Choose the detector without confirmation, and report everything that it finds."""
    return reporting_everything(
        msgspec.structs.replace(config, confirm=msgspec.structs.replace(config.confirm, enabled=False))
    )


def untrained_alone(config: Config) -> Config:
    """Choose contrasts as detector, without confirmation."""
    return served_by("contrast", unconfirmed(config))
