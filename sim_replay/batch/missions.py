"""Replay each log of an archive as a mission of its own; one that fails is reported and stops no other."""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Final, NamedTuple

from auv_mcm.commands import read_config
from auv_mcm.errors import AuvMcmError, HardwareError, UsageError
from auv_mcm.safe_files import remove_unfinished
from auv_mcm.settings.config import Config
from auv_mcm.shell.whole_files import make_directory
from sim_replay.fitting.cascade.farm import AHEAD, Farm, run_tasks
from sim_replay.logs.archive import ArchivedLog
from sim_replay.logs.open_log import is_session, logs_config
from sim_replay.logs.session_parts import JoinedSession
from sim_replay.replay import replay
from sim_replay.results_folder import is_replayed, named_path, summary_of

MISSIONS: Final = "missions"
"""Folder with the results of every log."""
_LOCK: Final = ".lock"
_DEFECT: Final = 1  # exit code of an error that is not meant for a person


class MissionTask(NamedTuple):
    """Name a log, the folder of its results and the configuration, None for a session's own or the defaults."""

    log: ArchivedLog
    folder: Path
    config: Config | None


class MissionOutcome(NamedTuple):
    """Say how the replay of a log ended. failure: why it failed, empty if it did not; exit_code: as of the command."""

    log: ArchivedLog
    folder: Path
    failure: str = ""
    exit_code: int = 0


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """Keep other runs out of the folder of results. Raises UsageError while another run is at work there."""
    make_directory(out)
    with open(out / _LOCK, "wb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise UsageError(f"another run writes to {out}. Wait for it, stop it, or name another folder") from error
        remove_unfinished(out)
        yield


def replay_missions(
    tasks: Sequence[MissionTask], farm: Farm, progress: Callable[[int], None] = lambda done: None
) -> Generator[MissionOutcome, None, None]:
    """Replay every log that has no results yet, and yield how each ended, in the order of the tasks.

    A log that kills its process is tried once more in a process of its own, and then reported as failed; on a cluster,
    whose scheduler tries it on other workers, it is reported at once. Raises HardwareError for a cluster that is lost.
    """
    n_done, was_empty = 0, False

    def ended(outcome: MissionOutcome) -> MissionOutcome:
        nonlocal n_done
        n_done += 1
        progress(n_done)
        return outcome

    while n_done < len(tasks):
        before, n_left = n_done, len(tasks) - n_done
        alone = n_left
        if farm.scheduler is not None or min(farm.workers, n_left) > 1:
            try:
                for outcome in run_tasks(replay_mission, tasks[n_done:], farm):
                    yield ended(outcome)
                return
            except HardwareError as error:
                if farm.scheduler is not None:
                    if was_empty and n_done == before:  # nothing has come back twice: it is the cluster, not a log
                        raise
                    was_empty, task = n_done == before, tasks[n_done]
                    yield ended(MissionOutcome(task.log, task.folder, str(error), error.exit_code))
                    continue
            # One of those under way killed its process, and with it what its neighbours were about to report.
            alone = AHEAD * farm.workers
        for task in tasks[n_done : n_done + alone]:
            yield ended(_alone(task))


def _alone(task: MissionTask) -> MissionOutcome:
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
            return process.submit(replay_mission, task).result()
    except BrokenProcessPool:
        why = "its process died, perhaps for lack of memory. Replay it by itself, on a computer with more"
        return MissionOutcome(task.log, task.folder, why, HardwareError.exit_code)


def replay_mission(task: MissionTask) -> MissionOutcome:
    """Replay one log, unless its results are there already, made of the same log with the same configuration."""
    try:
        recorded = logs_config([task.log.path]) if task.config is None else None
        config = task.config or recorded or read_config(None)
        if not is_replayed(task.folder, config) or _has_grown(task):
            replay([task.log.path], task.folder, config, waits=True)  # for what a run that was killed left behind
    except AuvMcmError as error:
        return MissionOutcome(task.log, task.folder, str(error), error.exit_code)
    except OSError as error:
        why = f"{error.filename or 'input or output'}: {error.strerror or error}"
        return MissionOutcome(task.log, task.folder, why, HardwareError.exit_code)
    except Exception as error:  # a defect in one log must not cost the others
        return MissionOutcome(task.log, task.folder, f"defect: {type(error).__name__}: {error}", _DEFECT)
    return MissionOutcome(task.log, task.folder)


def _has_grown(task: MissionTask) -> bool:
    """Check whether a session went on since its results were made, into files that they do not name."""
    if not is_session(task.log.path):
        return False
    made_of = {str(named_path(entry)) for entry in (summary_of(task.folder) or {}).get("logs", ())}
    return made_of != set(map(str, JoinedSession(task.log.path).sizes_bytes))
