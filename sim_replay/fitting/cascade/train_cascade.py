"""Train the detector's cascade from the tiles that a specification renders, for `auv-mcm train`."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import msgspec

from auv_mcm.detect.cascade.model import encode_model
from auv_mcm.errors import UsageError
from auv_mcm.shell.whole_files import write_file
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.cascade.spec import read_training_spec
from sim_replay.fitting.cascade.store import MANIFEST_NAME, read_manifest
from sim_replay.fitting.cascade.trainer import train
from sim_replay.fitting.cascade.training_images import render_set, tile_set_words


def train_model(
    spec: Path | None, out: Path, *, tiles: Path | None, n_stumps: int, farm: Farm, say: Callable[[str], None]
) -> None:
    """Train a cascade and write it to `out`, JSON.

    Parameters
    ----------
    spec
        YAML file of what to render, the set that ships if None.
    tiles
        Folder that keeps the rendered tiles; those that it holds of the same spec are used as they are.
    n_stumps
        Of the cascade, at most.
    say
        Takes lines on progress.

    Raises
    ------
    UsageError
        For an `out` that cannot be written, before any work, and for a spec that cannot be read.
    """
    if not out.parent.is_dir():
        raise UsageError(f"--out {out}: there is no folder {out.parent}. Make it first")
    with tempfile.TemporaryDirectory() as passing:
        folder = tiles or Path(passing)
        if not _holds_tiles_of(folder, spec):
            for line in tile_set_words(render_set(spec, folder, farm)).splitlines():
                say(line)
        data = encode_model(train(folder, farm, say, n_stumps))
    try:
        write_file(out, data)
    except OSError as error:
        raise UsageError(f"--out {out} cannot be written: {error.strerror}") from error


def _holds_tiles_of(folder: Path, spec: Path | None) -> bool:
    wanted = msgspec.json.decode(
        msgspec.json.encode(read_training_spec(spec)[0])
    )  # as the manifest gives it back: lists, not tuples
    return (folder / MANIFEST_NAME).exists() and read_manifest(folder).made_from == wanted
