"""Define what a recorded log is, and read formats that other packages add through entry points.

An entry point of the group `auv_mcm.logs` names a `LogReader`. Readers of other packages are imported only for a file
in which no built-in format is recognised.
"""

from __future__ import annotations

import logging
import math
import os
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple, Protocol

from msgspec import structs

from auv_mcm.errors import AuvMcmError, BadInputError, UsageError
from auv_mcm.records import NavSample, Notice, Ping, SourceEvent
from auv_mcm.safe_files import open_regular
from auv_mcm.settings.config import Config
from auv_mcm.settings.plugins import Plugin, find_plugins, load_plugin, plugin_problem, remedy
from drivers.plugin_records import check_record, clean_counters, own_samples

log = logging.getLogger(__name__)


class Log(Protocol):
    """Read one recorded log.

    Iterate for its events in order of time; every iteration starts anew, with new counters.
    """

    @property
    def sizes_bytes(self) -> dict[Path, int]:
        """Return the size of each file in use, in order of time."""
        ...

    @property
    def bytes_read(self) -> int:
        """Count the bytes read so far."""

    @property
    def counters(self) -> Counter[str]:
        """Count what reading skipped or mended so far."""
        ...

    def first_time_s(self) -> float:
        """Find the time of the first ping, s since 1970. Raises BadInputError for a log that cannot be used."""
        ...

    def __iter__(self) -> Iterator[SourceEvent]: ...


def first_placed_s(log: Log, path: Path, no_navigation: str) -> float:
    """Find the time of the first ping of a log that holds positions, s since 1970.

    Parameters
    ----------
    path
        Of the log, for the message.
    no_navigation
        Where a log of this format would hold positions, and what to do.

    Raises
    ------
    BadInputError
        For a log without usable pings or without positions.
    """
    first_s: float | None = None
    has_position = False
    for event in log:
        if isinstance(event, Ping) and first_s is None and math.isfinite(event.time_s):
            first_s = event.time_s
        elif isinstance(event, NavSample) and math.isfinite(event.latitude_deg + event.longitude_deg):
            has_position = True
        if first_s is not None and has_position:
            return first_s
    if first_s is not None:
        raise BadInputError(f"{path} holds pings but not one position: {no_navigation}")
    seen = ", ".join(f"{name} {n}" for name, n in sorted(log.counters.items())) or "nothing"
    raise BadInputError(
        f"{path} holds no usable side-scan ping ({seen}). Check that the recording was not stopped at once and that "
        "the file was fetched whole."
    )


class LogReader(NamedTuple):
    """Describe a format of logs, for an entry point of another package.

    title: the format's name for people. recognises: whether a file is of this format, given its first bytes, 1 MiB at
    most. events: yields the pings, navigation and notices of a file in order of time, each ping stamped with its
    transmission; it is given the path, the file opened at its start for reading bytes, the configuration, and a counter
    for what is skipped or mended, such as `myformat.damaged_records`. It may be called several times for one file. It
    raises BadInputError, with the path, for a file that cannot be used; damage within a file is skipped and counted.
    """

    title: str
    recognises: Callable[[bytes], bool]
    events: Callable[[Path, BinaryIO, Config, Counter[str]], Iterator[SourceEvent]]


CERTAIN: Final = 1 << 30
"""Claim of a format whose first bytes are its own; others claim as many messages as they find."""


class LogFormat(NamedTuple):
    """Describe a format of logs that is read.

    title: for people. recognises: how much speaks for the format in a file's first bytes, 1 MiB at most; 0 for nothing.
    opens: opens a file, given the configuration and the size of the read buffer in bytes; it raises BadInputError or
    UsageError. is_side_scan: a sonar's own format, which mostly holds side scan. is_image: it needs a sidecar. files: a
    pattern of the names of files that make their folder a log of this format.
    """

    name: str
    title: str
    recognises: Callable[[bytes], int]
    opens: Callable[[Path, Config, int], Log]
    is_side_scan: bool = False
    is_image: bool = False
    files: str = ""


def added_formats(head: bytes) -> tuple[list[LogFormat], list[str]]:
    """Find the formats of other packages that recognise the first bytes of a file.

    Returns them, and what is wrong with readers that do not work and what to do, a sentence each.
    """
    found: list[LogFormat] = []
    problems: list[str] = []
    for plugin in find_plugins():
        if plugin.kind != "logs":
            continue
        try:
            reader = reader_of(plugin)
            if reader.recognises(head):
                found.append(added_format(plugin, reader))
        except UsageError as error:
            problems.append(str(error))
        except Exception as error:  # code of others raises whatever it likes
            problems.append(f"{plugin}: failed with {error!r}. {remedy(plugin)}")
    return found, problems


def added_format(plugin: Plugin, reader: LogReader) -> LogFormat:
    """Make the row of a format that another package reads."""

    def opens(path: Path, config: Config, chunk_bytes: int) -> Log:
        return AddedLog(path, plugin, reader, config)

    return LogFormat(str(plugin), reader.title, lambda head: int(reader.recognises(head)), opens)


def reader_of(plugin: Plugin) -> LogReader:
    """Import a reader of logs. Raises UsageError if it cannot be used."""
    if problem := plugin_problem(plugin, ()):
        raise UsageError(f"log reader {problem}")
    return load_plugin(plugin, LogReader)


class AddedLog:
    """Read a log by another package's code. Where that code fails, the log ends with a notice, and the mission goes on.

    counters: those of the reader, and reader.failed.
    """

    def __init__(self, path: Path, plugin: Plugin, reader: LogReader, config: Config) -> None:
        self._path, self._plugin, self._events, self._config = path, plugin, reader.events, config
        self._size_bytes = path.stat().st_size
        self._counters: Counter[str] = Counter()
        self._n_failed = 0
        self._file: BinaryIO | None = None

    @property
    def sizes_bytes(self) -> dict[Path, int]:
        return {self._path: self._size_bytes}

    @property
    def bytes_read(self) -> int:
        """Count the bytes read so far."""
        if self._file is None or self._file.closed:
            return 0
        return min(self._file.seek(0, os.SEEK_CUR), self._size_bytes)

    @property
    def counters(self) -> Counter[str]:
        return clean_counters(self._counters) + Counter({"reader.failed": self._n_failed})

    def first_time_s(self) -> float:
        """Find the time of the first ping, s since 1970. Raises BadInputError for a log that cannot be used."""
        failure = ""
        for event in self:
            if isinstance(event, Ping) and math.isfinite(event.time_s):
                return event.time_s
            failure = event.text if isinstance(event, Notice) and event.code == "log_reader_failed" else failure
        raise BadInputError(failure or f"{self._path} holds no ping. Check that a sonar was connected.")

    def __iter__(self) -> Iterator[SourceEvent]:
        self._counters, self._n_failed = Counter(), 0
        n_events = 0
        with open_regular(self._path) as self._file:
            try:
                for event in self._events(self._path, self._file, self._config, self._counters):
                    check_record(event, Ping, NavSample, Notice)
                    yield own_samples(event) if isinstance(event, Ping) else event
                    n_events += 1
            except (AuvMcmError, OSError):
                raise
            except (Exception, SystemExit) as error:  # code of others raises whatever it likes
                self._n_failed = 1
                log.exception("the reader %s failed", self._plugin)
                text = (
                    f"{self._path} was read up to event {n_events} only: {self._plugin} failed with {error!r}. "
                    f"{remedy(self._plugin)}"
                )
                yield Notice(code="log_reader_failed", text=text, place=str(self._path))


class ExchangedSides:
    """Read a log with port and starboard exchanged."""

    def __init__(self, log: Log) -> None:
        self._log = log
        self.first_time_s = log.first_time_s

    @property
    def sizes_bytes(self) -> dict[Path, int]:
        return self._log.sizes_bytes

    @property
    def bytes_read(self) -> int:
        """Count the bytes read so far."""
        return self._log.bytes_read

    @property
    def counters(self) -> Counter[str]:
        return self._log.counters

    def __iter__(self) -> Iterator[SourceEvent]:
        for event in self._log:
            if isinstance(event, Ping):
                event = structs.replace(event, port=event.starboard, starboard=event.port)
            yield event
