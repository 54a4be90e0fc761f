"""Name the operating points that are compared: the default, budgets, and the references beside the chain."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final, NamedTuple

import msgspec

from auv_mcm.settings.config import Config
from sim_replay.benches.run_time.one_run import DEFAULT
from sim_replay.missions import unconfirmed, untrained_alone

Configure = Callable[[Config], Config]


class ChainSetting(NamedTuple):
    """Name one way to run the chain.

    knob: what is turned; value: to what. configure: makes its configuration from the mission's. is_plain_script: not
    the chain at all.
    """

    name: str
    knob: str
    value: str
    configure: Configure
    is_plain_script: bool = False


PLAIN: Final = "plain script"
BUDGET: Final = "budget"
DUTIES: Final = (0.002, 0.01, 0.015, 0.02, 0.03, 0.05, 0.1, 0.2)
"""From 1 % to all of what the dearest tiles of the named scenes and recorded lines need, a fifth of one core."""
REASON: Final = (
    "the cascade, the gate and the odds were fitted at this point, so that p_mine is calibrated here and nowhere else"
)
"""Why the default operating point is the default, beside what the measurement says."""


def _same(config: Config) -> Config:
    return config


def _with_duty(duty: float, config: Config) -> Config:
    return msgspec.structs.replace(config, budget=msgspec.structs.replace(config.budget, duty=duty))


def chain_settings() -> tuple[ChainSetting, ...]:
    """List every operating point, the default first."""
    return (
        ChainSetting(DEFAULT, DEFAULT, "", _same),
        ChainSetting(PLAIN, "reference", "", _same, is_plain_script=True),
        ChainSetting("contrasts alone", "reference", "", untrained_alone),
        ChainSetting("cascade alone", "reference", "", unconfirmed),
        *(ChainSetting(f"budget.duty {duty}", BUDGET, str(duty), partial(_with_duty, duty)) for duty in DUTIES),
    )
