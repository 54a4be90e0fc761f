"""A world small enough to be flown in a second."""

from __future__ import annotations

import msgspec

from auv_mcm.settings.config import Config
from sim_replay.adaptive.decide import by_replanning
from sim_replay.adaptive.flight import AdaptiveFlight, fly_adaptive
from sim_replay.adaptive.order import Order, drawn_scene, limits_of, usual_order
from sim_replay.simulator.plan import local_frame
from sim_replay.simulator.scene import Scene, Seabed, World
from tests.make.looks import EvenLook

SIDE_M = 36.0


def small_scene(seed: int = 1) -> Scene:
    """Bare sand under a coarse sonar."""
    scene = drawn_scene(seed)
    return msgspec.structs.replace(
        scene,
        objects=(),
        world=World(depth_m=25.0, seabeds=(Seabed(type="sand"),), cell_m=0.2),
        sonar=msgspec.structs.replace(scene.sonar, range_m=24.0, n_samples=240, ping_rate_hz=6.0, beam_lines=1),
    )


def small_order(required: float = 0.6, budget_m: float = 800.0) -> Order:
    return usual_order(SIDE_M, required, budget_m)


def coarse_config() -> Config:
    config = Config()
    return msgspec.structs.replace(
        config,
        confirm=msgspec.structs.replace(config.confirm, enabled=False),
        detect=msgspec.structs.replace(config.detect, model="none"),
        waterfall=msgspec.structs.replace(config.waterfall, row_spacing_m=0.3, column_spacing_m=0.15),
    )


def fly_small(worth: EvenLook, order: Order, seed: int = 1) -> AdaptiveFlight:
    scene = small_scene(seed)
    limits = limits_of(scene, order)
    replanning = by_replanning(order, worth, limits, local_frame(scene.origin))
    return fly_adaptive(scene, order, replanning, limits, worth, coarse_config(), lambda ground: order.required)
