"""Find out what a session that was cut off, or whose disk was full, left out of its results, and report how to get
it."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shlex
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from auv_mcm import __version__, kernels
from auv_mcm.errors import AuvMcmError
from auv_mcm.model_file import named_files
from auv_mcm.plan.look_again import LooksSoFar
from auv_mcm.program import program
from auv_mcm.records import Notice, report_number
from auv_mcm.safe_files import read_regular, sync_directory, sync_file
from auv_mcm.settings.config import Config, ServiceConfig
from auv_mcm.shell.journal import Journal
from auv_mcm.shell.journal_contacts import id_in
from auv_mcm.shell.latest_session import latest_session
from auv_mcm.shell.whole_files import write_file
from auv_mcm.source import AnnouncedContact

RECORDING: Final = "recording"
"""The folder, among the results, for what live ports received and were sent."""
JOURNAL: Final = "contacts.jsonl"
"""The file, among the results, of contacts as they were announced."""
EARLY_JOURNAL: Final = "early.jsonl"
"""The file of early contacts as they were announced, and of what became of them; there is none without early
contacts."""
STATE: Final = "state"
"""The folder, among the results, of what a restart goes on from; it goes when the session comes to its end."""
_MEMORY: Final = "service.json"
RECORDS: Final = "records.bin"
"""The file in it of contacts and coverage."""
SUMMARY: Final = "summary.json"
"""The file that is written last: its presence shows that the session came to its end."""

LOST_PINGS: Final = {
    "service.ping_dropped": "came faster than perception worked",
    "service.ping_too_large": "are larger than the memory between the processes",
}
"""Counters of pings that did not come to perception, and why."""

BALLAST_BYTES: Final = 16 << 20  # contacts.geojson takes about 1 kB a contact, contacts.csv 0.2 kB
_MAX_NAMED: Final = 20  # contacts in one notice
_MIN_BALLAST_BYTES: Final = 1 << 16  # bytes; where less than this can be had, none is held


class Ballast:
    """Hold disk space until the results are written. Pictures, recording and other programs thus leave some for them.

    n_bytes: what is held, 0 where the disk is full or cannot set space aside.
    """

    def __init__(self, folder: Path, max_bytes: int = BALLAST_BYTES) -> None:
        """Take `max_bytes`, or the largest half, quarter ... of it that there is. The file has no name and goes with
        the process."""
        self.n_bytes = 0
        self._file = contextlib.ExitStack()
        with contextlib.suppress(OSError):
            file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115, open as long as the mission
            descriptor = self._file.enter_context(file).fileno()
            while max_bytes >= _MIN_BALLAST_BYTES and not self.n_bytes:
                try:
                    os.posix_fallocate(descriptor, 0, max_bytes)
                    self.n_bytes = max_bytes
                except OSError:
                    os.ftruncate(descriptor, 0)
                    max_bytes //= 2

    def release(self) -> None:
        """Give the space back."""
        self._file.close()


def unfinished_session(parent: Path) -> Notice | None:
    """Report that the last session has a recording but no results.

    It was killed, or the power was cut.
    """
    try:
        last = latest_session(parent)
        if (last / SUMMARY).exists() or not any((last / RECORDING).iterdir()) or Journal.is_in_use(last / JOURNAL):
            return None
    except (OSError, AuvMcmError):  # there is no such session, or it has no recording
        return None
    return in_recording(last, f"the session before, in {last}, was cut off")


_ADDRESSES: Final = ((None, "link"), ("sonar", "command_link"), ("navigation", "pulse_link"))
"""Keys of a port, by section, that say where its device is and not what it sends."""


class SessionMemory(msgspec.Struct, frozen=True, kw_only=True):
    """Hold what the service itself goes on from after a restart; perception has its checkpoints.

    kind: see `session_kind`. started_s: UTC of the first start. n_starts: how often it was started. elapsed_s: time
    that it ran. counters: of all but perception. looks: what planning knows. is_over: its last contacts are announced.
    """

    kind: str
    started_s: float
    n_starts: int
    elapsed_s: float
    notices: tuple[Notice, ...] = ()
    counters: dict[str, int] = {}
    looks: LooksSoFar = LooksSoFar()
    is_over: bool = False


class Announced(NamedTuple):
    """Hold what was announced before a restart, by number of the event, id and state of an early contact."""

    known: frozenset[tuple[int, str, str]]
    is_clutter: dict[str, bool]  # of contacts, as announced last
    contacts: dict[int, AnnouncedContact]  # early ones, too, by the number of their reports


class Unfinished(NamedTuple):
    """Hold a session that is gone on with."""

    folder: Path
    memory: SessionMemory


def write_memory(folder: Path, memory: SessionMemory) -> None:
    """Write the service's own memory among the state. Raises OSError."""
    write_file(folder / STATE / _MEMORY, msgspec.json.encode(memory))


def resumable_session(parent: Path, kind: str, now_s: float, within_h: float) -> Unfinished | Notice | None:
    """Find the session to go on with: the last one, if it was cut off less than within_h before.

    A notice states why one that was cut off is not gone on with; None where there is none.

    now_s: UTC. A clock that is behind, as after a power cut without a battery, does not make a session too old.
    """
    try:
        last = latest_session(parent)
        if last.parent != parent or not (last / STATE).is_dir() or (last / STATE).is_symlink():
            return None
        if Journal.is_in_use(last / JOURNAL):
            return None
        age_h = (now_s - max(path.stat().st_mtime for path in (last / STATE).iterdir())) / 3600.0
        memory = msgspec.json.decode((last / STATE / _MEMORY).read_bytes(), type=SessionMemory)
    except (OSError, AuvMcmError, ValueError):  # there is none, or a power cut came before anything was in it
        return None
    if memory.kind != kind:
        return _not_resumed(last, "the program or its configuration is another one")
    if memory.is_over:
        has_results = (last / SUMMARY).exists()  # a kill came before its state was removed
        return None if has_results else _not_resumed(last, "its last contacts were announced, and would be found twice")
    if age_h > within_h:
        return _not_resumed(last, f"it is {age_h:.0f} h old, more than service.resume_within_h")
    return Unfinished(last, memory)


def _not_resumed(folder: Path, why: str) -> Notice:
    text = f"the session before, in {folder}, was cut off and is not gone on with: {why}. {_replay_advice(folder)}"
    return Notice(code="session_not_resumed", text=text)


class _Properties(msgspec.Struct):
    id: str
    classification: str = msgspec.field(name="class", default="")
    p_mine: float = 0.0


class _Feature(msgspec.Struct):
    properties: _Properties


class _Line(msgspec.Struct):
    contact: _Feature
    event: int = 0
    state: str = ""


def read_announced(folder: Path) -> Announced:
    """Read from the journals what was announced; of a last line that was cut off nothing was. Raises OSError."""
    known: set[tuple[int, str, str]] = set()
    is_clutter: dict[str, bool] = {}
    contacts: dict[int, AnnouncedContact] = {}
    decoder = msgspec.json.Decoder(_Line)
    for name in (JOURNAL, EARLY_JOURNAL):
        path = folder / name
        Journal.cut_torn_line(path)
        if not path.exists():
            continue
        with path.open("rb") as file:
            for text in file:
                try:
                    line = decoder.decode(text)
                except msgspec.MsgspecError:  # a bad block: the contact is known all the same
                    if name == JOURNAL and (contact := id_in(text)):
                        is_clutter.setdefault(contact, False)
                        _count(contacts, contact, 1.0)
                else:
                    properties = line.contact.properties
                    known.add((line.event, properties.id, line.state))
                    _count(contacts, properties.id, properties.p_mine)
                    if name == JOURNAL:
                        is_clutter[properties.id] = properties.classification == "clutter"
    return Announced(frozenset(known), is_clutter, contacts)


def _count(contacts: dict[int, AnnouncedContact], name: str, p_mine: float) -> None:
    """Count a line of a journal among those of its contact."""
    before = contacts.get(number := report_number(name), AnnouncedContact(0, 0.0))
    contacts[number] = AnnouncedContact(before.n_revisions + 1, max(before.p_mine, p_mine))


def session_kind(config: Config) -> str:
    """Name what a state fits: this program with its models and kernels, and what the configuration makes of bytes.

    Queues and folders are left out, and the addresses of ports: a device that moved to another socket sends the same.
    """
    of_chain = msgspec.to_builtins(msgspec.structs.replace(config, service=ServiceConfig()))
    for port in of_chain["ports"]:
        for section, address in _ADDRESSES:
            of = port if section is None else port.get(section) or {}
            of.pop(address, None)
    digest = hashlib.sha256(msgspec.json.encode(of_chain, order="deterministic"))
    for name in named_files(config).values():
        with contextlib.suppress(OSError, AuvMcmError):  # perception, which needs it, says what is wrong
            digest.update(hashlib.sha256(read_regular(Path(name))).digest())
    return f"{__version__} {program()} {kernels.backend()} {digest.hexdigest()}"


def remove_state(folder: Path) -> None:
    """Remove what a restart would go on from. What cannot be removed stays.

    The memory goes first: with it and without the rest, a restart would write empty results over those of the session.
    """
    state = folder / STATE
    with contextlib.suppress(OSError):
        if not state.is_symlink():
            (state / _MEMORY).unlink(missing_ok=True)
            sync_directory(state)
            shutil.rmtree(state)


def in_recording(folder: Path, why: str, *, is_gone_on_with: bool = False) -> Notice:
    """Report that contacts which were not announced are in the recording of a session alone.

    is_gone_on_with: at the next start.
    """
    advice = "The next start goes on with the session. " if is_gone_on_with else ""
    text = f"{why}: contacts that were not announced yet are in the recording alone. {advice}{_replay_advice(folder)}"
    return Notice(code="contacts_in_recording", text=text)


def in_journal(folder: Path, names: Sequence[str], gone: Sequence[str] = ()) -> Notice:
    """Report that contacts which were announced are in the journal alone: a power cut or a bad disk took the rest.

    gone: those of them that the journal does not give back either.
    """
    first = ", ".join(names[:_MAX_NAMED]) + (f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else "")
    text = (
        f"{first} were announced, and the disk did not keep what they were seen in. The results have them as {JOURNAL} "
        f"of {folder} does, without views and picture; no other contact has their numbers. "
        + (f"Of {', '.join(gone[:_MAX_NAMED])} the number alone is left. " if gone else "")
        + f"Check the disk. {_replay_advice(folder)}"
    )
    return Notice(code="contacts_in_journal", text=text)


def pings_lost(n_lost: Mapping[str, int], is_recording: bool) -> Notice:
    """Report pings that did not come to perception. n_lost: by counter, of `LOST_PINGS`."""
    whys = " and ".join(f"{n} {LOST_PINGS[name]}" for name, n in n_lost.items() if n)
    rest = "A replay of the recording takes them." if is_recording else "They are gone: service.record is off."
    text = (
        f"{sum(n_lost.values())} pings so far were lost: {whys}. What only they show is not found. {rest} Set "
        "budget.duty to what this computer affords, lower the sonar's ping rate or samples, or see what else keeps the "
        "computer busy."
    )
    return Notice(code="service.pings_lost", text=text)


def all_written(writers: Mapping[str, Callable[[], None]]) -> dict[str, OSError]:
    """Call every writer. Returns what failed, by name: of a disk that is nearly full, small files take what is left."""
    errors = {}
    for name, write in writers.items():
        try:
            write()
        except OSError as error:
            errors[name] = error
    return errors


def all_synced(folder: Path) -> dict[str, OSError]:
    """Wait until the disk holds the files of a folder, all at once: one by one takes a slow disk many times as long.

    Returns what failed, by name.
    """
    files: list[Path] = []
    with contextlib.suppress(OSError):  # a folder that is gone fails below
        files += (path for path in folder.iterdir() if path.is_file() and not path.is_symlink())
    with ThreadPoolExecutor(len(files) + 1) as threads:
        syncing = {path.name: threads.submit(sync_file, path) for path in files}
        syncing[folder.name] = threads.submit(sync_directory, folder)
    return {name: error for name, done in syncing.items() if isinstance(error := done.exception(), OSError)}


def results_missing(folder: Path, errors: Mapping[str, OSError]) -> Notice:
    """Report the results that could not be written, why, and what there is instead."""
    text = (
        f"{', '.join(errors)} cannot be written to {folder}: {next(iter(errors.values())).strerror}. Contacts "
        f"announced while there was room are in {JOURNAL} there. Make room on the disk."
    )
    return Notice(
        code="results_missing", text=text + (f" {_replay_advice(folder)}" if (folder / RECORDING).is_dir() else "")
    )


def _replay_advice(folder: Path) -> str:
    return f"To get them run: auv-mcm report {shlex.quote(str(folder))}"
