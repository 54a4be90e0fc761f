"""Train the detector for a sonar and a sea of your own.

    python own_training_set.py OUT

OUT gets theatre.yaml, which says what is simulated, the labelled tiles, and model.json, a detector for `detect.model`.
This one is tiny, so that it is done within seconds, and finds nothing worth having: for use, take the counts and the
number of stumps of sim_replay/fitting/cascade/default.yaml, and a scene file of the sea that you expect.
"""

from __future__ import annotations

import sys
from pathlib import Path

from auv_mcm.detect.cascade.model import parse_model
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.cascade.store import read_manifest
from sim_replay.fitting.cascade.train_cascade import train_model

# `scenes` may name files beside this one. The grid of the picture is part of the set: a model serves the pixel sizes
# that it was trained for. Missions to validate on have seeds, and so sea floors, of their own.
THEATRE = """
scenes: [small.yaml]
seeds:
  train: {first: 600, count: 1}
  validate: {first: 700, count: 1}
targets:
  per_mission: 12
  apart_m: 4
  kinds:
    cylinder: {share: 2, length_m: [1.4, 2.6], width_m: [0.42, 0.65]}
    sphere: {share: 1, width_m: [0.6, 1.0]}
rocks: {per_mission: 8}
sonars:
  - {frequency_khz: 450, range_m: 25, n_samples: 400, ping_rate_hz: 12, row_spacing_m: 0.12, column_spacing_m: 0.06}
"""
SCENE = """
name: small
world: {depth_m: 14, seabeds: [{type: sand, share: 0.7}, {type: rippled_sand, share: 0.3}]}
track: {altitude_m: 5, plan: {pattern: lawnmower, n_legs: 1, leg_m: 60}}
"""


def main(out: Path) -> None:
    """Write a spec, render its training set, and train on it."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "small.yaml").write_text(SCENE)
    (out / "theatre.yaml").write_text(THEATRE)
    tiles, model = out / "tiles", out / "model.json"
    train_model(out / "theatre.yaml", model, tiles=tiles, n_stumps=4, farm=Farm(workers=1), say=print)

    for shard in read_manifest(tiles).shards:
        print(
            f"{shard.file}: {shard.n_tiles} tiles, {shard.n_targets} views of targets, {shard.n_others} of other "
            "objects"
        )
    trained = parse_model(model.read_bytes(), str(model))
    print(f"{model}: {trained.n_stumps} stumps; to use it: detect: {{model: {model}}} in the configuration")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
