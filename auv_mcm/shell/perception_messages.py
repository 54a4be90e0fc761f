"""Define what crosses between the service and the perception process, apart from the samples of pings."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

from auv_mcm import errors
from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.contacts.coverage_store import StoredPatch
from auv_mcm.contacts.operating_point import OperatingPoint
from auv_mcm.contacts.record_file import RecordPlace
from auv_mcm.plan.look_again import Proposal
from auv_mcm.records import Contact, EarlyContact, Notice, SourceEvent
from auv_mcm.shell.ping_ring import RingPing
from auv_mcm.shell.tally import Tally


class PerceptionError(errors.HardwareError):
    """Report that the perception process failed or died."""


class Fed(NamedTuple):
    """Answer one event, or the end of the mission, with what became final because of it.

    events: contacts, early ones among them, without what their pictures are made of, and notices. snippets: a PNG
    picture per contact id. places: in the file of records, of the contacts by number, without those that the disk did
    not take. patches: coverage, in that file too. number: of the event.
    """

    events: tuple[Contact | EarlyContact | Notice, ...]
    snippets: dict[str, bytes]
    places: dict[int, RecordPlace]
    patches: tuple[StoredPatch, ...]
    number: int = 0


class Started(NamedTuple):
    """Announce a worker that is ready, with the number of the last event in the checkpoint that it goes on from.

    contacts, coverage: the states of their stores then; tally: what had been fed. Number 0: it starts with nothing.
    """

    number: int
    contacts: Any = None
    coverage: Any = None
    tally: Tally | None = None


class Checkpointed(NamedTuple):
    """Report that a checkpoint was written after event `number`.

    It is to be committed once the answers before this one were announced.
    """

    number: int


class Reserve(NamedTuple):
    """Number contacts to come behind the first `n_contacts`."""

    n_contacts: int


class Numbered(NamedTuple):
    """Hand over an event, a ping as what is left of it without its samples."""

    number: int
    event: SourceEvent | RingPing


class Planned(NamedTuple):
    """Answer a request for a plan."""

    proposal: Proposal


class Finished(NamedTuple):
    """Give the last answer."""

    counters: Counter[str]
    places: dict[str, Any]  # by range and strength, for the summary
    operating_point: OperatingPoint | None
    clearance: Clearance | None
    clearance_png: bytes  # its picture, empty without one


class Failure(NamedTuple):
    """Hold an exception of the worker, in words: not every exception survives pickling."""

    kind: str
    text: str

    def error(self) -> Exception:
        """Make the exception of its kind, PerceptionError where that is none of ours."""
        kind = getattr(errors, self.kind, PerceptionError)
        return kind(self.text) if issubclass(kind, errors.AuvMcmError) else PerceptionError(self.text)
