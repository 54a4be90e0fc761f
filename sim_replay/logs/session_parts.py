"""Read the recordings of one session, one for each start of the service, as one mission.

The rule: each part is decoded as its start decoded it, from empty decoders on, and all feed one chain in the order of
the starts, as the service did. A part that the service ended in order gives everything it holds. Of one that was cut
off, what its decoders still held is dropped, as the service lost it: a message of which a piece is missing, and
navigation that waits to be put in order, a quarter of a second and the longest latency. What came in the last second
before a cut and is not on disk is in no replay; what came while nothing ran was not recorded.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from auv_mcm.errors import BadInputError
from auv_mcm.records import Notice
from auv_mcm.shell.recovery import JOURNAL, RECORDING, SUMMARY
from drivers.recording.session_layout import FILE_PATTERN, PartEnd, Recorded

if TYPE_CHECKING:
    from sim_replay.logs.session_reader import Session


def recordings_of(session: Path) -> list[Path]:
    """List the recordings in a session's folder, one for each start of the service, in order; empty if it is none."""
    found = [path for path in session.glob(f"{RECORDING}*") if path.is_dir() and start_of(path)]
    return sorted(found, key=start_of)


def start_of(recording: Path) -> int:
    """Give the number of the start that a recording is of, from 1; 0 for a folder of another name."""
    number = recording.name.removeprefix(RECORDING) if recording.name.startswith(RECORDING) else "-"
    return 1 if not number else int(number[1:]) if number[0] == "-" and number[1:].isdecimal() else 0


def session_of(path: Path) -> Path:
    """Find the session's folder that a recording lies in; any other path is given back."""
    folder = path.resolve()
    if not folder.is_dir() or not start_of(folder) or not any(folder.glob(FILE_PATTERN)):
        return path
    parent = folder.parent
    return parent if any((parent / name).exists() for name in (JOURNAL, SUMMARY)) else path


def parts_of(path: Path) -> list[Path]:
    """List the recordings that a path stands for, in the order of the starts.

    A session's folder stands for all of them, and so does the first of them, `recording`. Another one, or a file,
    stands for itself. Empty for a folder that holds none.
    """
    if not path.is_dir():
        return [path]
    if not any(path.glob(FILE_PATTERN)):
        return [part for part in recordings_of(path) if any(part.glob(FILE_PATTERN))]
    beside = _beside(path)
    return beside if len(beside) > 1 and beside[0] == path.resolve() else [path]


class JoinedSession:
    """Read the parts of a session in the order of their starts; every iteration starts anew.

    part: index of the one that is being read. Counts, beside what `Session` does, session.parts where there are
    several, and session.parts_unusable.
    """

    def __init__(self, path: Path) -> None:
        """Read the head of every file that `parts_of` finds. A part of which nothing can be read is left out with a
        notice while others can.

        Raises BadInputError for a path without a session, or a session with nothing left.
        """
        from sim_replay.logs.session_reader import Session  # MCAP, which other logs need not

        paths = parts_of(path) or [path]
        self._left_out: list[Notice] = []
        self._sessions: list[Session] = []
        for part in paths:
            try:
                self._sessions.append(Session(part))
            except BadInputError as error:
                if len(paths) == 1:
                    raise
                self._left_out.append(_unusable(part, str(error)))
        if not self._sessions:
            raise BadInputError(
                "nothing of this session can be read:\n" + "\n".join(f"  {notice.text}" for notice in self._left_out)
            )
        self._n_unusable = len(self._left_out)
        self._left_out += _missing(paths) if len(paths) > 1 else _others_beside(path)
        self._begin()

    @property
    def sessions(self) -> Sequence[Session]:
        """Return the parts in use."""
        return self._sessions

    @property
    def sizes_bytes(self) -> dict[Path, int]:
        """Return the size of each file in use, in the order of recording."""
        return {path: size for session in self._sessions for path, size in session.sizes_bytes.items()}

    @property
    def bytes_read(self) -> int:
        """Count the bytes read so far."""
        before = sum(sum(session.sizes_bytes.values()) for session in self._sessions[: self.part])
        return before + (self._sessions[self.part].bytes_read if self._has_begun else 0)

    @property
    def counters(self) -> Counter[str]:
        """Count what reading skipped so far."""
        n_parts = len(self._sessions) if len(self._sessions) > 1 else 0
        own = Counter({"session.parts": n_parts, "session.parts_unusable": self._n_unusable})
        return sum((session.counters for session in self._begun()), +own)

    @property
    def notices(self) -> list[Notice]:
        """List the notices in the order in which they arose."""
        return [*self._left_out, *(notice for session in self._begun() for notice in session.notices)]

    def __iter__(self) -> Iterator[Recorded | PartEnd]:
        self._begin()
        return self._read()

    def _begin(self) -> None:
        self.part, self._has_begun = 0, False

    def _begun(self) -> Sequence[Session]:
        return self._sessions[: self.part + 1] if self._has_begun else ()

    def _read(self) -> Iterator[Recorded | PartEnd]:
        for part, session in enumerate(self._sessions):
            chunks = iter(session)
            self.part, self._has_begun = part, True
            if part:
                yield PartEnd(is_cut_off=self._sessions[part - 1].is_cut_off)
            yield from chunks


def _beside(path: Path) -> list[Path]:
    """List the parts of the session that a recording, or a file in one, lies in; empty if it lies in none."""
    recording = path.resolve() if path.is_dir() else path.resolve().parent
    if not start_of(recording):
        return []
    return [part for part in recordings_of(recording.parent) if any(part.glob(FILE_PATTERN))]


def _others_beside(path: Path) -> list[Notice]:
    parts = _beside(path)
    files = [] if path.is_dir() else sorted(path.resolve().parent.glob(FILE_PATTERN))
    if len(parts) < 2 and len(files) < 2:
        return []
    beside = f"{len(parts)} recordings" if len(parts) > 1 else f"{len(files)} files"
    whole = path.resolve().parent if path.is_dir() or len(parts) < 2 else path.resolve().parent.parent
    text = (
        f"{path} is a part of a session that has {beside}; the others are left out. Name {whole} to have all of the "
        "session as one mission."
    )
    return [Notice(code="session_parts_beside", text=text, place=str(path))]


def _missing(parts: Sequence[Path]) -> list[Notice]:
    starts = [start_of(part.resolve()) for part in parts]
    missing = sorted(set(range(1, max(starts) + 1)) - set(starts))
    if not missing:
        return []
    names = ", ".join(RECORDING if start == 1 else f"{RECORDING}-{start}" for start in missing)
    text = (
        f"{names} of {parts[0].parent} is not there: what was recorded after that start is missing from the mission. "
        "Fetch the session's folder whole, unless the service recorded nothing then."
    )
    return [Notice(code="session_part_missing", text=text, place=str(parts[0].parent))]


def _unusable(part: Path, why: str) -> Notice:
    return Notice(code="session_file_unusable", text=f"recording left out: {why}", place=str(part))
