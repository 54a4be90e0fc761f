"""A recorded session replayed: its bytes go through the same decoders and merging as those of the ports did, with the recorded stamps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from auv_mcm.clock import Stamp
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import SourceEvent
from auv_mcm.settings.config import Config, parse_config
from drivers.recording.session_layout import FILE_PATTERN, PROFILE
from sim_replay.logs.session_reader import Session


class PortIntake(Protocol):
    """Decoders and merging of all ports. What comes out depends on the configuration and on what is fed alone: it reads no clock."""

    @property
    def counters(self) -> Counter[str]: ...

    def feed(self, port: str, data: bytes, stamp: Stamp) -> list[SourceEvent]:
        """Bytes of one port, in the order in which they were read. Empty ones only say how late it is."""
        ...

    def finish(self) -> list[SourceEvent]:
        """No bytes follow."""
        ...


def is_session(path: Path) -> bool:
    """Whether `path` looks like a recorded session: a folder with its files, or one of them."""
    if path.is_dir():
        return any(path.glob(FILE_PATTERN))
    try:
        with path.open("rb") as stream:
            return PROFILE.encode() in stream.read(64)
    except OSError:
        return False


def recorded_config(session: Session) -> Config:
    """The configuration that a session was recorded with. Raises BadInputError for one that this version does not know."""
    try:
        return parse_config(session.description.config_yaml, "the session's configuration")
    except UsageError as error:
        raise BadInputError(
            f"{error}\nIt was recorded by version {session.description.version}; replay it with that, or give a configuration."
        ) from error


class SessionMission:
    """A session as a mission to replay, like `sim_replay.logs.recorded.RecordedMission`."""

    def __init__(self, session: Session, intake: PortIntake) -> None:
        """intake: new, and made from the same configuration as the recorded one."""
        self._session = session
        self._intake = intake

    @property
    def sizes_bytes(self) -> dict[Path, int]:
        """Size of each file in use, in the order of recording."""
        return self._session.sizes_bytes

    @property
    def fraction_done(self) -> float:
        """How much of the files `events` has read, 0..1."""
        return self._session.bytes_read / sum(self.sizes_bytes.values())

    def counters(self) -> Counter[str]:
        """What reading and decoding skipped or mended so far."""
        return self._session.counters + self._intake.counters

    def events(self) -> Iterator[SourceEvent]:
        """What the service was given, once; what is wrong with the recording is told where it shows."""
        n_told = 0
        for recorded in self._session:
            yield from self._session.notices[n_told:]
            n_told = len(self._session.notices)
            if recorded.direction == "in":
                yield from self._intake.feed(recorded.port, recorded.data, recorded.stamp)
        yield from self._session.notices[n_told:]
        yield from self._intake.finish()
