"""Compare the joined replay of a session that was cut off with its undisturbed twin.

The twin is one chain that was never stopped and was given what each start's decoders made of the bytes that are left on
the disk. Events, contacts and coverage have to be the same to the byte.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from auv_mcm.contacts.record_file import packed
from auv_mcm.errors import BadInputError
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import CoveragePatch, Notice, SourceEvent
from auv_mcm.settings.config import Config
from auv_mcm.shell.recovery import JOURNAL
from drivers.port_intake import PortIntake
from drivers.recording.session_layout import Recorded
from sim_replay.hil.announced import not_in_journal
from sim_replay.hil.evidence import Restart
from sim_replay.logs.recorded import open_mission
from sim_replay.logs.session_parts import JoinedSession, recordings_of
from sim_replay.logs.session_reader import Session, recorded_config


def problems_of(session: Path, n_starts: int, console: Sequence[str]) -> tuple[str, ...]:
    """List what is wrong with a session after so many starts, in words; console: lines of all of them."""
    n_parts = len(recordings_of(session))
    problems = [] if n_parts == n_starts else [f"{n_starts} starts left {n_parts} recordings in {session.name}"]
    config = recorded_config(JoinedSession(session).sessions[0])
    problems += compared_with_twin(session, n_parts, config)[2]
    problems += [f"announced but not in the journal: {line}" for line in _lost(console, session)]
    return tuple(problems)


def compared_with_twin(folder: Path, n_parts: int, config: Config) -> tuple[int, int, tuple[str, ...]]:
    """Return how many events and contacts the joined replay has, and what differs from the twin, in words."""
    joined = [event for event in open_mission([folder], config).events() if not _is_of_reading(event)]
    twin = list(_twin(folder, n_parts, config))
    problems = [] if list(map(packed, joined)) == list(map(packed, twin)) else ["events differ"]
    contacts, coverage = _results(joined, config)
    if (contacts, coverage) != _results(twin, config):
        problems.append("contacts or coverage differ")
    return len(joined), len(contacts), tuple(problems)


def lost_by_kills(session: Path, restarts: Sequence[Restart]) -> tuple[float, ...]:
    """Measure what each kill cost: s from the last byte of its recording to the kill; infinite without any."""
    found = []
    for number, restart in enumerate(restarts, 1):
        last_s = max((chunk.stamp.mono_ns / 1e9 for chunk in _left_in(session, number)), default=-math.inf)
        found.append(restart.mono_s - last_s)
    return tuple(found)


def recorded_bytes(session: Path) -> Counter[str]:
    """Count the bytes of input that the recordings of a session hold, by port."""
    chunks = (chunk for number in range(len(recordings_of(session))) for chunk in _left_in(session, number + 1))
    return sum((Counter({chunk.port: len(chunk.data)}) for chunk in chunks), Counter())


def _lost(console: Sequence[str], session: Path) -> tuple[str, ...]:
    """List announced contacts that no whole line of the journal holds. What a power cut tore is not one."""
    whole = [line for line in (session / JOURNAL).read_bytes().splitlines() if line.endswith(b"}")]
    return not_in_journal(console, b"".join(line + b"\n" for line in whole))


def _twin(folder: Path, n_parts: int, config: Config) -> Iterator[SourceEvent]:
    """Give one chain what each start's decoders made of its bytes; those that were cut off lost what they held."""
    for number in range(1, n_parts + 1):
        intake = PortIntake(config)
        for chunk in _left_in(folder, number):
            yield from intake.feed(chunk.port, chunk.data, chunk.stamp)
        if number == n_parts:
            yield from intake.finish()


def _left_in(session: Path, number: int) -> Iterable[Recorded]:
    part = session / ("recording" if number == 1 else f"recording-{number}")
    try:
        return [chunk for chunk in Session(part) if chunk.direction == "in"]
    except BadInputError:  # a power cut before the first chunk was whole
        return []


def _results(events: Iterable[SourceEvent], config: Config) -> tuple[list[bytes], list[bytes]]:
    """Run the chain; give its contacts and its coverage."""
    pipeline = Pipeline(config)
    coverage = []
    for event in events:
        coverage += [packed(made) for made in pipeline.feed(event) if isinstance(made, CoveragePatch)]
    coverage += [packed(made) for made in pipeline.finish() if isinstance(made, CoveragePatch)]
    return [packed(one) for one in sorted(pipeline.contacts, key=lambda one: one.id)], coverage


def _is_of_reading(event: SourceEvent) -> bool:
    return isinstance(event, Notice) and event.code.startswith("session_")
