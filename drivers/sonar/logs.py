"""Logs that hold what came from a sonar, byte for byte: .svlog, .jsf."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from auv_mcm.clock import Stamp
from auv_mcm.errors import BadInputError
from drivers.sonar.sonar_decoder import SonarDecoder, SonarFrame, SonarReply

NOT_RECEIVED: Final = Stamp(0, 0)
"""The stamp of what was read from a log: nobody noted when it arrived."""

_CHUNK_BYTES: Final = 1 << 18


def read_log(path: Path, decoder: SonarDecoder) -> Iterator[SonarFrame | SonarReply]:
    """What the log says, in order, with memory that does not depend on its length. The decoder's counters tell what was damaged.

    Raises BadInputError for a file that cannot be read, and at its end if there was not a single frame in it.
    """
    n_frames = 0
    try:
        with path.open("rb") as file:
            while chunk := file.read(_CHUNK_BYTES):
                for item in decoder.feed(chunk, NOT_RECEIVED):
                    n_frames += isinstance(item, SonarFrame)
                    yield item
    except OSError as error:
        raise BadInputError(f"{path} cannot be read: {error.strerror}. Check the path and its permissions.") from error
    for item in decoder.finish():
        n_frames += isinstance(item, SonarFrame)
        yield item
    if n_frames == 0:
        told = ", ".join(f"{name} {n}" for name, n in sorted(decoder.counters.items())) or "it is empty"
        raise BadInputError(f"{path} holds no sonar frame ({told}). Check that it is a log of this kind of sonar.")
