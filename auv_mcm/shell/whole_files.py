"""Write files that are whole or absent, and make the directory that they go to."""

from __future__ import annotations

import errno
import json
import math
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from auv_mcm.clean_text import clean_json
from auv_mcm.errors import UsageError
from auv_mcm.safe_files import replacing

TAKES_NOTHING: Final = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
"""Errors of a disk that is full or can only be read: a mission goes on without it."""

_REMEDIES: Final = {
    errno.ENOSPC: "Free space on this disk",
    errno.EDQUOT: "Free space, or raise this user's quota",
    errno.EROFS: "Mount it for writing, or add it to ReadWritePaths and RequiresMountsFor of the systemd unit",
    errno.EIO: "Check the disk",
    errno.EACCES: "Change its owner, or let the systemd unit wait for its disk by RequiresMountsFor",
}
"""What to do about a directory that cannot be written to, by the reason."""


def write_file(path: Path, data: bytes, *, durable: bool = True) -> None:
    """Replace `path` by `data`; a power cut leaves the old file or the new one, never a piece. Raises OSError.

    durable: False where it is synced later.
    """
    write_parts(path, [data], durable=durable)


def write_parts(path: Path, parts: Iterable[bytes], *, durable: bool = True) -> None:
    """Replace `path` by the parts, one behind the other, as `write_file`. Raises OSError."""
    with replacing(path, durable=durable) as file:
        file.writelines(parts)


def write_json(path: Path, data: Any) -> None:
    """Write indented, `finite` JSON. Control characters are escaped, so that a terminal may show it. Raises OSError."""
    text = json.dumps(finite(data), indent=2, ensure_ascii=False, allow_nan=False).encode("utf-8", "replace").decode()
    write_file(path, (clean_json(text) + "\n").encode())


def finite(data: Any) -> Any:
    """Replace NaN and infinities, which JSON lacks, by None; keys become texts, and tuples lists."""
    if isinstance(data, dict):
        return {str(key): finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [finite(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data


def make_directory(path: Path) -> Path:
    """Make a directory if it is not there, and check that it can be written to. Raises UsageError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path).close()
    except OSError as error:
        raise UsageError(f"cannot write to the output directory {path}: {why_refused(error)} another one.") from error
    return path


def why_refused(error: OSError) -> str:
    """Say why a directory takes no file and what to do, up to the last remedy, which is "another one"."""
    if isinstance(error, FileExistsError | NotADirectoryError):
        return "a file is in its place. Name"
    remedy = _REMEDIES.get(error.errno or 0)
    return f"{error.strerror}. {remedy}, or name" if remedy else f"{error.strerror}. Name"
