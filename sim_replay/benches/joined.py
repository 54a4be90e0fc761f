"""Cut a recorded session as kills and power cuts do, and compare the joined replay with its undisturbed twin.

auv-mcm bench soak --joined N --recording SESSION [--seed N]

The recording is written anew as a session of several starts: each ends at a random chunk, four of five as a kill leaves
the file (all chunks that were flushed, no end), one as a power cut does (torn at any byte of its last quarter), and
some chunks come while nothing runs. The twin is one chain that was never stopped and was given what each start's
decoders made of the bytes that are left. Events, contacts and coverage have to be the same to the byte.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from auv_mcm.settings.config import Config
from drivers.recording.session_layout import Recorded
from drivers.recording.session_writer import SessionWriter
from sim_replay.hil.joined_twin import compared_with_twin
from sim_replay.logs.session_parts import JoinedSession
from sim_replay.logs.session_reader import Session, recorded_config

CUTS_PER_SESSION: Final = 10  # each start then decodes a tenth of the mission
_POWER_CUTS: Final = 5  # one cut of so many is a power cut
_MAX_SKIPPED: Final = 60  # chunks that come while nothing runs
_TORN_SHARE: Final = 0.25  # of the last file, in which a power cut tears it: more than a second of it


class JoinedOutcome(NamedTuple):
    """Hold what a session came to. problems: in words, what must not be."""

    n_kills: int
    n_power_cuts: int
    n_events: int
    n_contacts: int
    problems: tuple[str, ...]


def joined_outcomes(recording: Path, n_cuts: int, seed: int, folder: Path) -> Iterator[JoinedOutcome]:
    """Cut sessions made of a recording off n_cuts times in all, and compare each. Raises BadInputError."""
    whole = JoinedSession(recording).sessions[0]
    chunks = [recorded for recorded in whole if recorded.direction == "in"]
    config = recorded_config(whole)
    random = np.random.Generator(np.random.PCG64(seed))
    while n_cuts > 0:
        n_here = min(n_cuts, CUTS_PER_SESSION)
        session = folder / f"session-{n_cuts}"
        yield _outcome(whole, chunks, config, n_here, random, session)
        n_cuts -= n_here


def _outcome(
    whole: Session, chunks: Sequence[Recorded], config: Config, n_cuts: int, random: np.random.Generator, folder: Path
) -> JoinedOutcome:
    ends = sorted(random.choice(np.arange(1, len(chunks) - 1), n_cuts, replace=False).tolist())
    is_power = [index % _POWER_CUTS == _POWER_CUTS - 1 for index in random.permutation(n_cuts).tolist()]
    first = 0
    for number, end in enumerate([*ends, len(chunks)]):
        part = folder / ("recording" if number == 0 else f"recording-{number + 1}")
        writer = SessionWriter(part, whole.description, reserve_bytes=0)
        for chunk in chunks[min(first, end) : end]:
            writer.add(chunk)
        if number == n_cuts:
            writer.close()
            break
        writer.flush()
        writer.abandon()
        if is_power[number]:
            (file,) = part.iterdir()
            size = file.stat().st_size
            os.truncate(file, int(random.integers(round((1.0 - _TORN_SHARE) * size), size)))
        first = end + int(random.integers(0, _MAX_SKIPPED))
    compared = compared_with_twin(folder, n_cuts + 1, config)
    return JoinedOutcome(n_cuts - sum(is_power), sum(is_power), *compared)
