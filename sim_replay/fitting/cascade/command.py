"""Trains the detector's cascade from nothing: `auv-mcm train [SPEC.yaml] --out MODEL.json`.

Missions are rendered into labelled tiles as SPEC.yaml says, or taken from a folder where they were; then a cascade is trained on them.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec

from auv_mcm.detect.cascade.model import encode_model
from auv_mcm.errors import UsageError
from auv_mcm.settings.config import Config
from auv_mcm.shell.results import write_file
from sim_replay.arguments import count
from sim_replay.fitting.cascade.classical.model import format_model
from sim_replay.fitting.cascade.classical.train import train_classical
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.cascade.spec import read_spec
from sim_replay.fitting.cascade.store import MANIFEST_NAME, read_manifest, read_tiles
from sim_replay.fitting.cascade.trainer import N_STUMPS, train
from sim_replay.fitting.cascade.training_images import render_set, told_of
from sim_replay.missions import untrained_alone

_KINDS_HELP: Final = "soft cascade; to compare with: stages as in the source paper, or a discriminant on classical features (default soft)"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="auv-mcm train", description=__doc__)
    parser.add_argument("spec", nargs="?", type=Path, metavar="SPEC.yaml", help="what to render (default: the set that ships)")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="where the model goes, JSON")
    parser.add_argument("--tiles", type=Path, metavar="DIR", help="folder of the tiles; rendered into it unless it holds those of the spec")
    parser.add_argument("--kind", choices=("soft", "stages", "classical"), default="soft", help=_KINDS_HELP)
    parser.add_argument("--stumps", type=count, default=N_STUMPS, help=f"stumps of a soft cascade (default {N_STUMPS})")
    parser.add_argument("--workers", type=count, default=2, help="tasks at once on this computer (default 2)")
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="run tasks on the cluster of this dask scheduler instead")
    chosen = parser.parse_args(arguments)
    if not chosen.out.parent.is_dir():
        raise UsageError(f"--out {chosen.out}: there is no folder {chosen.out.parent}. Make it first")
    started_s = time.monotonic()

    def say(line: str) -> None:
        print(f"{time.monotonic() - started_s:6.0f} s  {line}", file=sys.stderr, flush=True)

    farm = Farm(chosen.workers, chosen.scheduler)
    with tempfile.TemporaryDirectory() as passing:
        folder = chosen.tiles or Path(passing)
        if not _holds_tiles_of(folder, chosen.spec):
            for line in told_of(render_set(chosen.spec, folder, farm)).splitlines():
                say(line)
        if chosen.kind == "classical":
            tiles = read_tiles(folder, read_manifest(folder), "train")
            data = format_model(train_classical(tiles, untrained_alone(Config())))
        else:
            data = encode_model(train(folder, chosen.kind, farm, say, chosen.stumps))
    try:
        write_file(chosen.out, data)
    except OSError as error:
        raise UsageError(f"--out {chosen.out} cannot be written: {error.strerror}") from error
    return 0


def _holds_tiles_of(folder: Path, spec: Path | None) -> bool:
    wanted = msgspec.json.decode(msgspec.json.encode(read_spec(spec)[0]))  # as the manifest gives it back: lists, not tuples
    return (folder / MANIFEST_NAME).exists() and read_manifest(folder).made_from == wanted
