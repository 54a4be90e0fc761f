"""Name the operating points that are compared: the default, one knob turned at a time, and the references beside the
chain."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec

from auv_mcm.detect.cascade.choose import shipped_model
from auv_mcm.detect.cascade.model import encode_model
from auv_mcm.model_file import NONE
from auv_mcm.settings.config import Config
from sim_replay.benches.run_time.one_run import DEFAULT
from sim_replay.missions import unconfirmed, untrained_alone

Configure = Callable[[Config, Path], Config]


class ChainSetting(NamedTuple):
    """Name one way to run the chain.

    knob: what is turned; value: to what. configure: makes its configuration from the mission's; what that names is
    written into the folder given. is_plain_script: not the chain at all.
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


def _same(config: Config, _: Path) -> Config:
    return config


def _set(section: str, values: dict[str, Any], config: Config, _: Path) -> Config:
    changed = msgspec.structs.replace(getattr(config, section), **values)
    return msgspec.structs.replace(config, **{section: changed})


def _turned(knob: str, section: str, key: str, value: Any) -> ChainSetting:
    return ChainSetting(f"{section}.{key} {value}", knob, str(value), partial(_set, section, {key: value}))


def _pixels(row_m: float, column_m: float) -> ChainSetting:
    sizes = {"row_spacing_m": row_m, "column_spacing_m": column_m}
    name = f"{row_m:g} x {column_m:g} m"
    return ChainSetting(f"pixels {name}", "pixel size", name, partial(_set, "waterfall", sizes))


def _shallow(n_groups: int) -> ChainSetting:
    """Cut the last groups off the shipped cascade; the calibration stays that of the whole one."""
    model = shipped_model()
    n_stumps = sum(len(group) for group in itertools.islice(model.groups, n_groups))

    def configure(config: Config, folder: Path) -> Config:
        cut = msgspec.structs.replace(model, groups=model.groups[:n_groups], reject=model.reject[:n_groups])
        path = folder / f"cascade-{n_stumps}.json"
        path.write_bytes(encode_model(cut))
        return _set("detect", {"model": str(path)}, config, folder)

    return ChainSetting(f"cascade of {n_stumps} stumps", "cascade depth", str(n_stumps), configure)


def _unconfirmed(config: Config, _: Path) -> Config:
    return unconfirmed(config)


def _untrained(config: Config, _: Path) -> Config:
    return untrained_alone(config)


def chain_settings() -> tuple[ChainSetting, ...]:
    """List every operating point, the default first."""
    return (
        ChainSetting(DEFAULT, DEFAULT, "", _same),
        ChainSetting(PLAIN, "reference", "", _same, is_plain_script=True),
        ChainSetting("contrasts alone", "reference", "", _untrained),
        ChainSetting("cascade alone", "reference", "", _unconfirmed),
        *(_turned(BUDGET, "budget", "duty", duty) for duty in DUTIES),
        *(_turned("lowest p_mine reported", "contacts", "min_p_mine", p) for p in (0.0, 0.001, 0.05)),
        *(_turned("lowest p_mine looked at", "confirm", "min_p_mine", p) for p in (0.001, 0.05)),
        *(_turned("candidates per tile", "detect", "max_candidates_per_tile", n) for n in (8, 32)),
        *(_turned("looks per tile", "confirm", "max_per_tile", n) for n in (2, 8)),
        *(_pixels(*size) for size in ((0.108, 0.054), (0.132, 0.066), (0.24, 0.12))),
        ChainSetting("no cascade", "cascade depth", "0", partial(_set, "detect", {"model": NONE})),
        *(_shallow(n) for n in (10, 15, 20)),
    )
