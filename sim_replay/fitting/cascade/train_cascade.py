"""Train the detector's cascade from the tiles that a specification renders, for `auv-mcm train`."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from auv_mcm.detect.cascade.model import encode_model
from auv_mcm.errors import UsageError
from auv_mcm.settings.config import SonarConfig
from auv_mcm.shell.whole_files import write_file
from sim_replay.fitting.cascade.farm import Farm
from sim_replay.fitting.cascade.spec import USUAL_SONAR, Spec, read_training_spec
from sim_replay.fitting.cascade.store import MANIFEST_NAME, read_manifest
from sim_replay.fitting.cascade.trainer import train
from sim_replay.fitting.cascade.training_images import made_from, render_set, tile_set_words


def train_model(
    spec: Path | None,
    out: Path,
    *,
    tiles: Path | None,
    n_stumps: int,
    farm: Farm,
    say: Callable[[str], None],
    sonar: SonarConfig = USUAL_SONAR,
) -> None:
    """Train a cascade and write it to `out`, JSON.

    Parameters
    ----------
    spec
        YAML file of what to render, the set that ships if None.
    tiles
        Folder that keeps the rendered tiles; those that it holds of the same spec and files are used as they are.
    n_stumps
        Of the cascade, at most.
    say
        Takes lines on progress.
    sonar
        That recorded the augmented logs.

    Raises
    ------
    UsageError
        Before any work for an `out` that cannot be written, and for a spec that cannot be read or lacks a split.
    """
    if not out.parent.is_dir():
        raise UsageError(f"--out {out}: there is no folder {out.parent}. Make it first")
    _refuse_incomplete(read_training_spec(spec)[0], spec)
    with tempfile.TemporaryDirectory() as passing:
        folder = tiles or Path(passing)
        if not _holds_tiles_of(folder, made_from(spec, sonar)):
            for line in tile_set_words(render_set(spec, folder, farm, sonar)).splitlines():
                say(line)
        data = encode_model(train(folder, farm, say, n_stumps))
    try:
        write_file(out, data)
    except OSError as error:
        raise UsageError(f"--out {out} cannot be written: {error.strerror}") from error


def _refuse_incomplete(known: Spec, spec: Path | None) -> None:
    """Refuse a set with nothing to train on, or nothing to validate by. Raises UsageError."""
    for split in ("train", "validate"):
        if getattr(known.seeds, split, None) is None and all(line.split != split for line in known.augmented):
            raise UsageError(
                f"{spec}: training needs the split `{split}`. Give `seeds.{split}`, such as {{first: 700, count: 1}}, "
                f"or an augmented folder with `split: {split}`"
            )


def _holds_tiles_of(folder: Path, made: dict[str, Any]) -> bool:
    wanted = msgspec.json.decode(msgspec.json.encode(made))  # as the manifest gives it back: lists, not tuples
    return (folder / MANIFEST_NAME).exists() and read_manifest(folder).made_from == wanted
