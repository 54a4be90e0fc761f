"""Read recorded logs as one mission: at once for the bench, or paced as a source of the service."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Final

from auv_mcm.clock import Clock
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import NavSample, Notice, Ping, SourceEvent
from auv_mcm.settings.config import Config
from auv_mcm.source import EventSink, SourceUri
from drivers.recording.session_layout import FILE_PATTERN
from sim_replay.logs.bottom_lines import FoundLine, corrected, find_bottom_line, unused_notice
from sim_replay.logs.log_reader import Log
from sim_replay.logs.open_log import CHUNK_BYTES, is_session, open_log
from sim_replay.logs.same_log import OpenedLog, PingsOnce, first_ping, without_repeats
from sim_replay.logs.session_parts import recordings_of

MAX_WAIT_S: Final = 5.0  # holes in a log longer than this are not waited out
_BATCH: Final = 32  # events read at once: a second of 15 pings; twice as many gain little


def open_mission(paths: Sequence[Path], config: Config, chunk_bytes: int = CHUNK_BYTES) -> RecordedMission:
    """Open logs of pings, or one recorded session of ports, as one mission.

    The recordings of one session, all named, are that session, and so are all their files.

    Raises UsageError or BadInputError.
    """
    paths = _whole_recordings(paths) if len(paths) > 1 else paths
    sessions = [path for path in paths if is_session(path)]
    if not sessions or len(paths) == 1:
        return RecordedMission(paths, config, chunk_bytes)
    _refuse_repeated(paths)
    folder = sessions[0].resolve().parent
    if sorted(path.resolve() for path in paths) != sorted(filter(is_session, recordings_of(folder))):
        raise UsageError(
            f"{sessions[0]} is a recorded session of ports, which is replayed by itself. Replay the others apart; of "
            "a session that was started several times name its folder, which stands for all its recordings."
        )
    return RecordedMission([folder], config, chunk_bytes)


class RecordedMission:
    """Read the logs of one mission, of any formats, in the order of their first pings, however they are named."""

    def __init__(self, paths: Sequence[Path], config: Config, chunk_bytes: int = CHUNK_BYTES) -> None:
        """Open every log and look for its first ping.

        A log without anything usable is left out with a notice if others are usable, and so is one that holds what
        another one holds. Raises UsageError for a log named
        twice, BadInputError for one that is not there, or if no log is usable.
        """
        _refuse_repeated(paths)
        self._notices: list[Notice] = []
        self._counters: Counter[str] = Counter()
        found: list[OpenedLog] = []
        for place, path in enumerate(paths):
            try:
                log = open_log(path, config, chunk_bytes)
                first_s = log.first_time_s()
                found.append(OpenedLog(first_s, place, log, first_ping(log) if len(paths) > 1 else None))
            except BadInputError as error:
                if len(paths) == 1:
                    raise
                self._counters["replay.log_unusable"] += 1
                self._notices.append(Notice(code="log_unusable", text=f"log left out: {error}", place=str(path)))
        if not found:
            raise BadInputError(
                "none of the logs can be used:\n" + "\n".join(f"  {notice.text}" for notice in self._notices)
            )
        # both sides of an image may begin at once
        found.sort(key=lambda item: (item.first_s, paths[item.place].name, str(paths[item.place])))
        found, repeated = without_repeats(found, config.sonar.subsystem)
        self._counters["replay.log_repeated"] += len(repeated)
        self._notices += repeated
        self._logs = [item.log for item in found]
        self._paths = [paths[item.place] for item in found]
        self._lines = [find_bottom_line(path, log) for path, log in zip(self._paths, self._logs, strict=True)]
        for line in self.bottom_lines:
            if line.line is None:
                self._counters["replay.bottom_line_unused"] += 1
                self._notices.append(unused_notice(line.path, line.problem))
        self._spans: dict[Path, tuple[float, float]] = {}
        self._done_bytes, self._whole_bytes = 0, sum(self.sizes_bytes.values())
        self._reading: Log | None = None

    @property
    def logs(self) -> list[Log]:
        """List the logs in use, in order of time."""
        return self._logs

    @property
    def notices(self) -> list[Notice]:
        """List what is to say of logs that are left out."""
        return self._notices

    @property
    def bottom_lines(self) -> list[FoundLine]:
        """List the corrected bottom lines beside the logs."""
        return [line for line in self._lines if line is not None]

    @property
    def named_logs(self) -> list[tuple[Path, Log]]:
        """List the logs in use and how they were named, in order of time."""
        return list(zip(self._paths, self._logs, strict=True))

    def log_at(self, time_s: float) -> tuple[Path, Log] | None:
        """Find the log, as it was named, that has pings before and after a time.

        None for none read so far, and for several, as where each side has a log of its own.
        """
        nothing = math.inf, -math.inf
        spans = [(self._spans.get(path, nothing), path, log) for path, log in self.named_logs]
        found = [(path, log) for (first_s, last_s), path, log in spans if first_s <= time_s <= last_s]
        return found[0] if len(found) == 1 else None

    @property
    def sizes_bytes(self) -> dict[Path, int]:
        """Return the size of each file in use, in order of time."""
        return {path: size for log in self._logs for path, size in log.sizes_bytes.items()}

    @property
    def fraction_done(self) -> float:
        """Return how much of the files `events` has read, 0..1."""
        reading_bytes = 0 if self._reading is None else self._reading.bytes_read
        return min(1.0, (self._done_bytes + reading_bytes) / self._whole_bytes)

    def counters(self) -> Counter[str]:
        """Count what the readers skipped or mended so far."""
        return sum((log.counters for log in self._logs), self._counters)

    def events(self) -> Iterator[SourceEvent]:
        """Read every log once, in order of time."""
        yield from self._notices
        self._done_bytes, once = 0, PingsOnce()
        for path, log, line in zip(self._paths, self._logs, self._lines, strict=True):
            self._reading = log
            given = log if line is None or line.line is None else corrected(log, line)
            for event in several_at_once(once.of(given) if len(self._logs) > 1 else given):
                if isinstance(event, Ping) and math.isfinite(event.time_s):
                    first_s, last_s = self._spans.get(path, (event.time_s, event.time_s))
                    self._spans[path] = min(first_s, event.time_s), max(last_s, event.time_s)
                yield event
            if once.n_repeated:
                text = f"{once.n_repeated} pings of {path} lie in a log before it, too: they count once"
                yield Notice(code="log_repeated", text=text, place=str(path))
            self._done_bytes += sum(log.sizes_bytes.values())
            self._reading = None


def several_at_once(events: Iterable[SourceEvent]) -> Iterator[SourceEvent]:
    """Read events several at once: one by one between the stages of the chain each costs a third more to read.

    Those read before a reader fails are given, too.
    """
    stream = iter(events)
    while True:
        batch: list[SourceEvent] = []
        try:
            batch.extend(islice(stream, _BATCH))
        finally:
            yield from batch
        if not batch:
            return


class Pace:
    """Schedule events at `speed` times real time; inf: at once."""

    def __init__(self, speed: float, clock: Clock) -> None:
        self._speed = speed
        self._clock = clock
        self._due_s = -math.inf
        self._last_s = math.nan

    def wait_s(self, event: SourceEvent) -> float:
        """Return seconds until `event` is due. Times that step back or leap do not make up or cost waiting time."""
        if math.isinf(self._speed) or not isinstance(event, Ping | NavSample) or not math.isfinite(event.time_s):
            return 0.0
        now_s = self._clock.monotonic_s()
        if math.isnan(self._last_s):
            self._due_s, self._last_s = now_s, event.time_s
        step_s = min(event.time_s - self._last_s, MAX_WAIT_S)
        if step_s > 0.0 or step_s < -MAX_WAIT_S:
            self._last_s = event.time_s
        self._due_s += max(step_s, 0.0) / self._speed
        return max(self._due_s - now_s, 0.0)


class ReplaySource:
    """Feed a recorded mission to the service, at the service's pace, so that a slow computer loses nothing."""

    lossless = True

    def __init__(self, mission: RecordedMission, pace: Pace) -> None:
        self._mission = mission
        self._pace = pace

    async def run(self, sink: EventSink) -> None:
        """Put every event of the mission, each when it is due."""
        import asyncio  # a replay from the command line needs none

        stream = self._mission.events()
        while batch := await asyncio.to_thread(lambda: list(islice(stream, _BATCH))):
            for event in batch:
                if (wait_s := self._pace.wait_s(event)) > 0.0:
                    await asyncio.sleep(wait_s)
                await sink.put(event)

    def counters(self) -> Counter[str]:
        return self._mission.counters()


def open_source(uri: SourceUri, config: Config, clock: Clock) -> ReplaySource:
    """Open replay:///path/to/mission.xtf?speed=1, of any log that `open_log` takes; speed: times real time, or max.

    Raises UsageError or BadInputError.
    """
    unknown = sorted(set(uri.options) - {"speed"})
    if unknown:
        raise UsageError(f"service.source '{uri.text}': unknown option '{unknown[0]}'. Known: speed")
    if not uri.path:
        raise UsageError(f"service.source '{uri.text}' names no log. Example: replay:///data/mission.xtf?speed=1")
    speed = parse_speed(uri.options.get("speed", "1"), f"service.source '{uri.text}'")
    return ReplaySource(open_mission([Path(uri.path)], config), Pace(speed, clock))


def parse_speed(text: str, place: str) -> float:
    """Parse `real` (1), `max` (inf) or a number of times real time. Raises UsageError."""
    try:
        speed = {"real": 1.0, "max": math.inf}.get(text) or float(text)
    except ValueError:
        speed = math.nan
    if not speed > 0.0:
        raise UsageError(f"{place}: speed '{text}' is neither real, max nor a number above 0")
    return speed


def _whole_recordings(paths: Sequence[Path]) -> Sequence[Path]:
    """Name recordings in place of their files where every file is named, as results name them."""
    folders = list(dict.fromkeys(path.parent for path in paths))
    files = {file.resolve() for folder in folders for file in folder.glob(FILE_PATTERN)}
    return folders if files == {path.resolve() for path in paths} else paths


def _refuse_repeated(paths: Sequence[Path]) -> None:
    seen: set[Path] = set()
    for path in paths:
        if not path.exists():
            raise BadInputError(f"{path} does not exist. Check the path.")
        if path.resolve() in seen:
            raise UsageError(f"{path} is given twice: its pings would count as two passes. Name each log once.")
        seen.add(path.resolve())
