"""Open files so that no link, pipe or device stands in for them: the one door for every file that a person names.

What is read is a regular file, and what is read whole has a size limit: a pipe would be waited for without end, a
device read without end. What is written follows no link: whoever may write to the directory of the results could
otherwise put one there and have the service overwrite another file.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final

from auv_mcm.errors import BadInputError

MAX_FILE_BYTES: Final = 1 << 28  # of results, models and tables: chosen, some ten times the largest
_NEW: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_UPDATED: Final = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
_TEMPORARY: Final = re.compile(r"\.[0-9a-f]{16}\.new")  # the name of a file that `replacing` writes
_DIRECTORY: Final = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC


def read_regular(path: Path, max_bytes: int = MAX_FILE_BYTES) -> bytes:
    """Read a regular file whole. Raises OSError, and BadInputError as `open_regular` does and for a larger file."""
    with open_regular(path) as file:
        # No more room is taken than the file has bytes, and one that grows meanwhile is no endless one.
        data = file.read(min(os.fstat(file.fileno()).st_size, max_bytes) + 1)
    if len(data) > max_bytes:
        raise BadInputError(
            f"{path} is larger than {max_bytes >> 10} KiB, the most that is read of such a file. Is it the right one?"
        )
    return data


def open_regular(path: Path, buffering: int = -1) -> BinaryIO:
    """Open a regular file for reading.

    Raises OSError, and BadInputError for a pipe, a socket or a device, and for a name that no file can have.

    A pipe would make its reader wait for ever, and opening a device may change its state: neither is opened.
    """
    try:
        mode = os.stat(path).st_mode
    except ValueError as error:  # a null character in it, or a half of a surrogate pair
        raise BadInputError(f"{path} is not a name that a file can have ({error}). Correct it.") from error
    _refuse_irregular(path, mode)

    def opener(name: str, flags: int) -> int:
        descriptor = os.open(name, flags | os.O_NOCTTY | os.O_NONBLOCK)  # a pipe opens at once
        try:
            _refuse_irregular(path, os.fstat(descriptor).st_mode)  # it may have been exchanged in between
        except BaseException:
            os.close(descriptor)
            raise
        return descriptor

    return open(os.fspath(path), "rb", buffering=buffering, opener=opener)


def _refuse_irregular(path: Path, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise BadInputError(f"{path} is not a regular file but a pipe, a socket or a device. Copy it to a disk first.")


@contextlib.contextmanager
def replacing(path: Path, *, directory: int | None = None, durable: bool = True) -> Iterator[BinaryIO]:
    """Write a new file, which takes the place of `path` once it is whole; of one that fails nothing is left.

    Raises OSError.

    Until then it has a name that nobody can foresee. A link at `path` is replaced, not followed.

    Parameters
    ----------
    directory
        The descriptor that `path` starts from, if not the working directory.
    durable
        On disk when the block ends.
    """
    temporary = path.with_name(f".{secrets.token_hex(8)}.new")
    try:
        descriptor = os.open(temporary, _NEW, 0o666, dir_fd=directory)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None  # of the file that is meant
    try:
        with open(descriptor, "wb") as file:
            yield file
            file.flush()
            if durable:
                os.fsync(descriptor)
        os.replace(temporary, path, src_dir_fd=directory, dst_dir_fd=directory)
    except BaseException as error:
        with contextlib.suppress(OSError):
            os.unlink(temporary, dir_fd=directory)
        if isinstance(error, OSError) and error.strerror and error.filename in (None, str(temporary)):
            raise OSError(error.errno, error.strerror, str(path)) from error  # of the file that is meant
        raise
    if durable and directory is None:
        sync_directory(path.parent)


def remove_unfinished(folder: Path) -> None:
    """Remove what `replacing` left below a folder when its process was killed; nobody else may be writing there."""
    for path in folder.rglob(".*.new"):
        if _TEMPORARY.fullmatch(path.name):
            path.unlink()


@contextlib.contextmanager
def own_directory(path: Path) -> Iterator[int]:
    """Give the descriptor of a directory, made if it is not there. Raises OSError, also for a link in its place."""
    with contextlib.suppress(FileExistsError):
        path.mkdir()
    descriptor = os.open(path, _DIRECTORY | os.O_NOFOLLOW)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def open_for_append(path: Path) -> BinaryIO:
    """Open a file, made if it is not there, to write behind its end, unbuffered.

    Raises OSError, also for a link or a pipe.
    """

    def opener(name: str, flags: int) -> int:
        return os.open(name, flags | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)

    return open(path, "ab", buffering=0, opener=opener)


def open_new(path: Path) -> BinaryIO:
    """Open a file that is not there yet for writing, unbuffered. Raises OSError, also for a link in its place."""
    return open(os.open(path, _NEW, 0o666), "wb", buffering=0)


def open_for_update(path: Path) -> BinaryIO:
    """Open a file, made if it is not there, for reading and writing anywhere, unbuffered.

    Raises OSError, also for a link.
    """
    return open(os.open(path, _UPDATED, 0o666), "r+b", buffering=0)


def sync_file(path: Path) -> None:
    """Wait until the disk holds what was written to a regular file. Raises OSError that names it."""
    with open_regular(path, buffering=0) as file:
        try:
            os.fsync(file.fileno())
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from error


def sync_directory(folder: Path) -> None:
    """Make the names in a directory durable. Raises OSError that names it."""
    descriptor = os.open(folder, _DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from error
    finally:
        os.close(descriptor)
