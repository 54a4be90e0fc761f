"""Find the logs of an archive, and give each a folder for its results."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final, NamedTuple

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.safe_files import read_regular
from auv_mcm.settings.strict_yaml import MAX_TEXT_BYTES
from sim_replay.logs.image_sidecar import sidecar_path
from sim_replay.logs.open_log import is_session
from sim_replay.logs.session_parts import recordings_of, start_of

LOG_SUFFIXES: Final = frozenset({".xtf", ".jsf", ".svlog", ".sdf", ".sl2", ".sl3", ".son", ".mcap"})
_IMAGE_SUFFIXES: Final = frozenset({".tif", ".tiff", ".png", ".npy", ".h5", ".nc"})
"""Of files that are taken for logs in a folder; their format is recognised by content. A list may name any file."""
_SIDES: Final = ("B002.SON", "B003.SON")  # of a Humminbird recording: the first one there stands for its folder


class ArchivedLog(NamedTuple):
    """Name a log and, relative to the archive, the folder of its results."""

    path: Path
    name: str


def logs_of(source: Path, out: Path) -> list[ArchivedLog]:
    """List the logs in a folder and in all below it, or those that a text file lists, a path a line.

    Sorted by name. Results below `out` are left out. Paths in a list are relative to its folder; empty lines and those
    that begin with # are left out. Raises UsageError for a source that is not there or cannot be read, a list that
    names a log twice, and BadInputError where there is no log.
    """
    try:
        paths = _below(source, out.resolve()) if source.is_dir() else _listed(source)
    except BadInputError as error:  # a pipe, a device, or too large
        raise UsageError(f"{error} Give a folder, or a text file with a path a line") from error
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not text in UTF-8"
        raise UsageError(
            f"{source} cannot be read: {reason}. Give a folder, or a text file with a path a line"
        ) from error
    if not paths:
        kinds = ", ".join(sorted(LOG_SUFFIXES))
        raise BadInputError(f"{source} holds no log ({kinds}). Give the folder of the logs, or a list of their paths")
    root = source if source.is_dir() else Path(os.path.commonpath([path.parent for path in paths]))
    return sorted((ArchivedLog(path, path.relative_to(root).as_posix()) for path in paths), key=lambda log: log.name)


def _below(folder: Path, out: Path) -> list[Path]:
    found: list[Path] = []
    root, linked = folder.resolve(), set[Path]()
    for parent, folders, files in os.walk(folder, onerror=_raise, followlinks=True):
        here = Path(parent)
        if here == folder and start_of(here) and is_session(here):
            return [here]
        parts = [part for part in recordings_of(here) if is_session(part)]
        found += parts[:1]  # the first start's stands for all
        folders[:] = [
            name
            for name in sorted(folders)
            if here / name not in parts and (here / name).resolve() != out and _is_new(here / name, root, linked)
        ]
        logs = [name for name in files if Path(name).suffix.lower() in LOG_SUFFIXES]
        sides = sorted((name for name in logs if name.upper() in _SIDES), key=str.upper)
        found += [here / name for name in logs if name in sides[:1] or not name.upper().endswith(".SON")]
        images = [here / name for name in files if Path(name).suffix.lower() in _IMAGE_SUFFIXES]
        found += [image for image in images if sidecar_path(image).name in files]
    return found


def _is_new(folder: Path, root: Path, linked: set[Path]) -> bool:
    """Decide whether to go into a folder: a link counts once, and not where it leads to what is gone through anyway."""
    place = folder.resolve()
    if not folder.is_symlink():
        return True
    if place in (root, *root.parents) or {root, *linked} & {place, *place.parents}:
        return False
    linked.add(place)
    return True


def _raise(error: OSError) -> None:
    raise error


def _listed(file: Path) -> list[Path]:
    lines = [line.strip() for line in read_regular(file, MAX_TEXT_BYTES).decode("utf-8-sig").splitlines()]
    paths = [Path(os.path.normpath(file.parent.absolute() / line)) for line in lines if line and line[0] != "#"]
    if twice := sorted({str(path) for path in paths if paths.count(path) > 1}):
        raise UsageError(f"{file} names {twice[0]} twice. Name each log once")
    return paths
