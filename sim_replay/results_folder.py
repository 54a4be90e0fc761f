"""Name the folder that results go to where nobody named one, and find the logs that results were made of."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote_to_bytes

import msgspec

from auv_mcm.errors import AuvMcmError, BadInputError, UsageError
from auv_mcm.model_file import named_files
from auv_mcm.program import program
from auv_mcm.safe_files import read_regular
from auv_mcm.settings.config import Config
from auv_mcm.shell.recovery import RECORDING, SUMMARY
from auv_mcm.shell.whole_files import finite
from sim_replay.logs.bottom_lines import lines_beside

RESULTS_SUFFIX: Final = "-results"
_LONGEST: Final = 60  # characters of a log's name that are kept: a folder's name stays readable


def default_results(logs: Sequence[Path], parent: Path = Path()) -> Path:
    """Name a folder below `parent` after the first log.

    A folder that holds results of the same logs, or nothing, is taken again; one that holds anything else is passed
    over, and the name gets a number.
    """
    first = logs[0].resolve()
    named = first.parent if first.name.startswith(RECORDING) and first.is_dir() else first
    stem = (named.name if named.is_dir() else named.stem)[:_LONGEST] or "mission"
    number = 1
    while True:
        folder = parent / (f"{stem}{RESULTS_SUFFIX}" if number == 1 else f"{stem}{RESULTS_SUFFIX}-{number}")
        if _may_be_taken(folder, logs):
            return folder
        number += 1


@contextmanager
def kept_alone(folder: Path, *, waits: bool = False) -> Iterator[None]:
    """Keep other runs out of a folder of results while one writes it.

    waits: until another has ended. Raises UsageError otherwise.
    """
    held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):  # of a file system without locks
            try:
                fcntl.flock(held, fcntl.LOCK_EX if waits else fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise UsageError(
                    f"another run writes to {folder}. Wait for it, stop it, or name another folder."
                ) from error
        yield
    finally:
        os.close(held)


def log_entry(path: Path, n_bytes: int, folder: Path) -> dict[str, Any]:
    """Name a log in the summary of the results in `folder`; by a URI, too, where its name is not valid UTF-8."""
    entry: dict[str, Any] = {"path": str(path.absolute()), "bytes": n_bytes, "relative": os.path.relpath(path, folder)}
    try:
        entry["path"].encode()
    except UnicodeEncodeError:
        entry["uri"] = path.absolute().as_uri()
    return entry


def named_path(entry: Mapping[str, Any]) -> Path:
    """Return where a log was, of which `log_entry` gave the entry."""
    uri = entry.get("uri")
    if isinstance(uri, str):
        return Path(os.fsdecode(unquote_to_bytes(uri.removeprefix("file://"))))
    return Path(str(entry.get("path", "")))


def resolved_log(entry: object, folder: Path) -> Path:
    """Find a log that results name: where it was, or of the same size relative to the results or beside them.

    Parameters
    ----------
    entry
        Of `logs` in the summary.
    folder
        Of the results.

    Raises
    ------
    FileNotFoundError
        If it is at none of these places, with the path that it had.
    """
    known = entry if isinstance(entry, dict) else {}
    named = named_path(known)
    relative = known.get("relative")
    places = [named, *([folder / os.path.dirname(relative) / named.name] if isinstance(relative, str) else [])]
    places += [folder / named, folder / named.name, folder.parent / named.name]
    size = known.get("bytes")  # another log may have the same name

    def is_it(place: Path) -> bool:
        return place.exists() and (place == named or not place.is_file() or size in (None, place.stat().st_size))

    found = next((place for place in places if named.name and is_it(place)), None)
    if found is None:
        raise FileNotFoundError(str(named))
    return found


def is_replayed(folder: Path, config: Config) -> bool:
    """Check whether a folder holds whole results of unchanged logs, by this program with this configuration.

    Bottom lines that were corrected since count as a change, and so do files that the configuration names.
    """
    summary = summary_of(folder)
    if summary is None:
        return False
    made_ns = (folder / SUMMARY).stat().st_mtime_ns
    with suppress(AttributeError, KeyError, TypeError):  # as of a summary that somebody edited
        logs = summary.get("logs") or ()
        same_log = bool(logs) and all(_is_unchanged(entry, made_ns) for entry in logs) and _are_older(config, made_ns)
        same_log = same_log and _used_lines(summary) == lines_beside(map(named_path, logs))
        return same_log and _is_same(summary.get("config"), config) and summary.get("program") == program()
    return False


def summary_of(folder: Path) -> dict[str, Any] | None:
    """Read the summary of a mission, which is written last; None if it is not there or damaged."""
    try:
        summary = json.loads(read_regular(folder / SUMMARY))
    except (OSError, ValueError, BadInputError):
        return None
    return summary if isinstance(summary, dict) else None


def _is_same(written: Any, config: Config) -> bool:
    """Compare as records: whether a default is written depends on the process that wrote it."""
    try:
        return bool(msgspec.convert(written, Config) == config)
    except (msgspec.ValidationError, AuvMcmError):
        return bool(written == finite(msgspec.to_builtins(config)))


def _is_unchanged(entry: dict[str, Any], made_ns: int) -> bool:
    """Check that a log is as large as its results say, and older than they are."""
    try:
        status = os.stat(named_path(entry))
    except OSError:
        return False
    return status.st_size == entry.get("bytes") and status.st_mtime_ns <= made_ns


def _are_older(config: Config, made_ns: int) -> bool:
    """Check that the models and lists that a configuration names are older than results."""
    try:
        return all(os.stat(file).st_mtime_ns <= made_ns for file in named_files(config).values())
    except OSError:
        return False


def _used_lines(summary: dict[str, Any]) -> set[tuple[str, str]]:
    return {(str(line["path"]), str(line["sha256"])) for line in summary.get("bottom_lines", ())}


def _may_be_taken(folder: Path, logs: Sequence[Path]) -> bool:
    if not folder.exists():
        return True
    if not folder.is_dir():
        return False
    try:
        entries = json.loads(read_regular(folder / SUMMARY))["logs"]
        found = [resolved_log(entry, folder).resolve() for entry in entries]
    except (OSError, ValueError, KeyError, TypeError, BadInputError):
        return not any(folder.iterdir())
    named = [log.resolve() for log in logs]  # a recording is the folder of its files
    return bool(found) and all(any(log in (path, *path.parents) for log in named) for path in found)
