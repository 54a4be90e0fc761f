"""Write the state of perception to disk, whole or not at all, and read the newest that is sound."""

from __future__ import annotations

import contextlib
import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from auv_mcm.safe_files import replacing, sync_directory

CHECKPOINT_S: Final = 10.0
"""s between two checkpoints after tiles, minimum: bounds what is written, at most 10 MB each, and what is replayed."""
_MAGIC: Final = b"auv-mcm checkpoint 2\n"
_CHECKSUM_BYTES: Final = 4  # of a CRC-32
_PATTERN: Final = "checkpoint-????????????.bin"
_N_KEPT: Final = 2  # the one before serves where the newest is damaged


class Keeping(NamedTuple):
    """State where checkpoints go, and what they belong to: one of another kind is not gone on from.

    every_s: between two after tiles, minimum.
    """

    folder: Path
    kind: str
    every_s: float = CHECKPOINT_S


def write_checkpoint(folder: Path, number: int, state: bytes) -> None:
    """Write the state after event `number`, on disk when it returns; it does not count before it is committed.

    Raises OSError.
    """
    with replacing(_pending(folder, number)) as file:
        file.writelines((_MAGIC, zlib.crc32(state).to_bytes(_CHECKSUM_BYTES, "little"), state))


def commit_checkpoint(folder: Path, number: int) -> None:
    """Have a checkpoint count from here on: what came of the events in it was announced.

    All but the one before are removed. Raises OSError.
    """
    os.replace(_pending(folder, number), folder / f"checkpoint-{number:012d}.bin")
    sync_directory(folder)
    given_up = (path for path in folder.glob("pending-*.bin") if int(path.stem.removeprefix("pending-")) < number)
    for path in [*_newest_first(folder)[_N_KEPT:], *given_up]:
        path.unlink(missing_ok=True)


def read_checkpoints(folder: Path) -> Iterator[tuple[int, bytes]]:
    """Read the sound checkpoints of a folder, the newest first: the number of the last event in it, and the state."""
    for path in _newest_first(folder):
        with contextlib.suppress(OSError):
            data = path.read_bytes()
            head, state = data[: len(_MAGIC) + _CHECKSUM_BYTES], data[len(_MAGIC) + _CHECKSUM_BYTES :]
            if head == _MAGIC + zlib.crc32(state).to_bytes(_CHECKSUM_BYTES, "little"):
                yield _number(path), state


def newest_checkpoint(folder: Path) -> int:
    """Give the number of the last event in the newest checkpoint, sound or not; 0 without one."""
    return max(map(_number, _newest_first(folder)), default=0)


def _pending(folder: Path, number: int) -> Path:
    return folder / f"pending-{number:012d}.bin"


def _newest_first(folder: Path) -> list[Path]:
    return sorted(folder.glob(_PATTERN), key=_number, reverse=True)


def _number(path: Path) -> int:
    return int(path.stem.removeprefix("checkpoint-"))
