"""Embed targets in a recorded log: write a new log, and the truth about the embedded targets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from auv_mcm.errors import UsageError
from auv_mcm.settings.config import Config
from auv_mcm.shell.whole_files import make_directory, write_file, write_json
from sim_replay.arguments import refuse_other_log
from sim_replay.augment.augmented_truth import augmented_truth_of
from sim_replay.augment.background_log import read_survey
from sim_replay.augment.embed import embed
from sim_replay.augment.targets import TargetSpec, place_targets
from sim_replay.augment.track import track_of

TRUTH_NAME: Final = "truth.json"


class Written(NamedTuple):
    """Report the output. n_hidden: objects that no pass shows more than a tenth of."""

    log: Path
    truth: Path
    n_objects: int
    n_targets: int
    n_hidden: int
    area_km2: float


def augment(
    log: Path,
    spec: TargetSpec,
    out: Path,
    config: Config,
    *,
    seabed: str | None = None,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Written:
    """Write the log with the spec's objects in it, and truth.json, into `out`.

    The log keeps its name; `out` is made if it is not there.

    Everything but the samples that the objects change is the log's own bytes. Equal logs, specs and configurations give
    equal bytes. progress: called with the fraction done, 0..1. Raises UsageError for a directory that cannot be written
    to or is the log's own, and for places that the log does not show; BadInputError for a log that nothing can be made
    of.
    """
    survey = read_survey(log, config)
    track = track_of(survey, config)
    placements = place_targets(spec, track)
    folder = make_directory(out)
    target = folder / log.name
    if target.exists() and target.samefile(log):
        raise UsageError(
            f"--out {out} is where the log itself lies, which is never overwritten: name another directory"
        )
    refuse_other_log(target, folder / TRUTH_NAME)
    done = embed(survey, track, placements, config, spec.seed, progress=progress)
    (folder / TRUTH_NAME).unlink(missing_ok=True)  # written last: its presence shows that it belongs to the log
    write_file(target, done.data)
    facts = augmented_truth_of(done.objects, track, log.name, spec.seed, seabed)
    write_json(folder / TRUTH_NAME, facts)
    return Written(
        log=target,
        truth=folder / TRUTH_NAME,
        n_objects=len(done.objects),
        n_targets=sum(one.scene_object.is_target for one in done.objects),
        n_hidden=sum(max(look.visible_fraction for look in one.looks) < 0.1 for one in done.objects),
        area_km2=facts["area_km2"],
    )
