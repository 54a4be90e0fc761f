"""Small pipelines for tests of the service around them; module level, so that a spawned process can find them."""

from __future__ import annotations

import contextlib
import hashlib
import os
import signal
import sys
import threading
import time
from collections import Counter
from typing import Any
from unittest import mock

import msgspec
import numpy as np

from auv_mcm.contacts.ledger import Contacts
from auv_mcm.contacts.operating_point import OperatingPoint
from auv_mcm.errors import BadInputError
from auv_mcm.records import (
    NAN,
    Contact,
    CoveragePatch,
    EarlyContact,
    EchoTrace,
    NavSample,
    Notice,
    Ping,
    PipelineEvent,
    ShapeModel,
    SourceEvent,
    Tile,
)
from auv_mcm.settings.config import Config
from tests.auv_mcm.classify import drawn_looks
from tests.make.records import patch_of, tile_with

START_S = 1_700_000_000.0


def trace(seed: int, n_samples: int = 32, dtype: str = "uint16") -> EchoTrace:
    samples = np.random.default_rng(seed).integers(0, 200, n_samples).astype(dtype)
    return EchoTrace(samples=samples, first_range_m=0.05, spacing_m=0.1)


def ping(number: int, port: EchoTrace | None = None, starboard: EchoTrace | None = None) -> Ping:
    return Ping(
        number=number,
        time_s=START_S + number,
        port=port or trace(2 * number),
        starboard=starboard or trace(2 * number + 1),
        altitude_m=5.0,
        place=f"ping {number}",
    )


def navigation(number: int) -> NavSample:
    return NavSample(time_s=START_S + number, latitude_deg=43.0 + 1e-5 * number, longitude_deg=5.0, heading_rad=0.0)


def contact(number: int, n_views: int = 0) -> Contact:
    return drawn_looks.contact(
        id=f"C{number:04d}",
        time_s=START_S + number,
        longitude_deg=5.0,
        p_mine=0.25,
        length_m=NAN,
        width_m=NAN,
        reasons=(f"view {n_views}",),
    )


class Base:
    """A contact and a coverage patch for every third ping; one more contact at the end."""

    def __init__(self, config: Config, kept: Contacts) -> None:
        self.kept = kept
        self.undecided: tuple[Contact, ...] = ()
        self.constants: dict[str, object] = {}
        self.counters: Counter[str] = Counter()
        self.places: dict[str, Any] = {}
        self.operating_point: OperatingPoint | None = None

    def state(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "kept"}

    def restore(self, state: dict[str, Any]) -> None:
        vars(self).update(state)

    def reserve(self, n_contacts: int) -> None:
        self.counters["fake.reserved"] = n_contacts

    def asking(self, min_p_mine: float) -> tuple[Contact, ...]:
        return self.undecided

    def leave_room(self, room: float) -> None:
        self.counters["fake.work_shed" if room < 1.0 else "fake.caught_up"] += 1

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        if isinstance(event, Notice):
            return [event]
        if not isinstance(event, Ping):
            return []
        self.counters["ping.received"] += 1
        if event.number % 3:
            return []
        return [self.find(contact(event.number)), patch(event.number)]

    def find(self, found: Contact) -> Contact:
        """Keep a contact, new or changed, as the ledger does."""
        self.kept.add(found)
        return found

    def finish(self) -> list[PipelineEvent]:
        return [self.find(contact(9999))]


class Unlikely(Base):
    """Keeps a contact more, from the first ping on, that never gets likely enough to be announced."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        if isinstance(event, Ping) and not event.number:
            self.kept.add(contact(5000))
        return super().feed(event)


class Digesting(Base):
    """Answers each ping with a digest of everything in it, and with a tile, which must not come across."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        return [empty_tile(), Notice(code="digest", text=digest(event))]


class Cluttered(Base):
    """Everything it finds is clutter."""

    def find(self, found: Contact) -> Contact:
        return super().find(msgspec.structs.replace(found, classification="clutter"))


class Seeing(Base):
    """A contact with a view at its first ping."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        outline = np.zeros((3, 2))
        solid = ShapeModel(
            classification="sphere", sizes={"radius_m": 0.4}, sigma={}, highlight=outline, shadow=outline
        )
        labels = np.zeros((4, 6), np.uint8)
        close = drawn_looks.confirmation(2.0, labels=labels, highlight=outline, shadow=outline, model=solid)
        view = drawn_looks.detection(snippet=np.full((4, 6), 100, np.uint8), score=7.5, confirmation=close)
        return [self.find(drawn_looks.contact(id="C00001", views=(view,)))]

    def finish(self) -> list[PipelineEvent]:
        return []


class Undecided(Base):
    """The first contact is a likely mine that another look may decide."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        events = super().feed(event)
        if isinstance(event, Ping) and event.number == 0:
            self.undecided = (
                self.find(msgspec.structs.replace(contact(0), p_mine=0.6, aspects_deg=(0.0,), next_look_deg=(90.0,))),
            )
            return [*self.undecided]
        return events


class Calling(Base):
    """Calls what has the usual p_mine."""

    def __init__(self, config: Config, kept: Contacts) -> None:
        super().__init__(config, kept)
        self.operating_point = OperatingPoint(config.contacts.false_alarms_per_km2, 11, 0.5, None)


class Failing(Base):
    """Has a defect at ping 5."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        if isinstance(event, Ping) and event.number == 5:
            raise ZeroDivisionError("division by zero")
        return super().feed(event)


class Quoting(Base):
    """Has a defect that quotes what a device sent."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        raise ValueError("no such mode: x\x1b[2J\n2026-01-01T00:00:00.000Z INFO ready")


class Refusing(Base):
    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        raise BadInputError("no such sonar")


class FullDisk(Base):
    """Is on a disk that is full from ping 1 on."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        if isinstance(event, Ping) and event.number == 1:
            mock.patch.object(os, "pwrite", side_effect=OSError(28, "No space left on device")).start()
        return super().feed(event)


class SeeingOnFullDisk(FullDisk, Seeing):
    """Sees on a disk that is full from ping 1 on."""


class OnSlowDisk(Base):
    """Is on a disk that syncs nothing before there is the file that DISK_ANSWERS names."""

    def __init__(self, config: Config, kept: Contacts) -> None:
        super().__init__(config, kept)
        mock.patch.object(os, "fsync", side_effect=self.sync).start()

    def sync(self, descriptor: int) -> None:
        while not os.path.exists(os.environ["DISK_ANSWERS"]):
            time.sleep(0.001)


class WaitingForTheDiskBeside(Base):
    """Has a thread that waits as for the disk, until somebody writes to the pipe that DISK_ANSWERS names."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        thread = threading.Thread(target=self.wait)
        thread.start()
        thread.join()
        return []

    def wait(self) -> None:
        pipe = (os.POSIX_SPAWN_OPEN, 0, os.environ["DISK_ANSWERS"], os.O_RDONLY, 0)
        os.posix_spawn("/bin/true", ["true"], {}, file_actions=[pipe])  # Linux has it wait in state D


class Unstartable(Base):
    def __init__(self, config: Config, kept: Contacts) -> None:
        raise RuntimeError("no model file")


class Dying(Base):
    """Is killed at ping 5, as by the kernel when memory runs out."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        if isinstance(event, Ping) and event.number == 5:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().feed(event)


class SeeingThenDying(Dying, Seeing):
    """Sees, and is killed at ping 5."""


class Slow(Base):
    """Takes longer for a ping than any source in these tests needs to make one."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        time.sleep(0.002)
        return super().feed(event)


class Pondering(Base):
    """Works on ping 5 for many of the tests' health periods."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        if isinstance(event, Ping) and event.number == 5:
            time.sleep(0.5)
        return super().feed(event)


class BusyAtItsEnd(Base):
    """Computes at its end for longer than any stop may take."""

    def finish(self) -> list[PipelineEvent]:
        end_s = time.thread_time() + 10.0
        while time.thread_time() < end_s:
            sum(range(10_000))
        return super().finish()


class Stuck(Base):
    """Never ends its work."""

    def finish(self) -> list[PipelineEvent]:
        while True:
            time.sleep(1.0)


def patch(number: int) -> CoveragePatch:
    ring = np.array([[5.0, 43.0], [5.001, 43.0], [5.001, 43.001], [5.0, 43.0]])
    times = {"start_s": START_S, "stop_s": START_S + 1}
    return patch_of(tile_index=number, rings_deg=(ring,), covered_m2=100.0, lost_m2={"turn": 1.0}, **times)


def empty_tile() -> Tile:
    return tile_with(np.empty((0, 0)), side="port", row_spacing_m=0.1, column_spacing_m=0.1)


def digest(event: SourceEvent) -> str:
    """Everything in an event, samples to the bit."""
    if not isinstance(event, Ping):
        return repr(event)
    parts = [repr((event.number, event.time_s, event.sound_speed_mps, event.altitude_m, event.place))]
    for side in (event.port, event.starboard):
        if side is None:
            parts.append("none")
        else:
            content = hashlib.sha256(np.ascontiguousarray(side.samples).tobytes()).hexdigest()
            parts.append(
                repr((side.samples.dtype.str, side.samples.shape, content, side.first_range_m, side.spacing_m))
            )
    return " ".join(parts)


class Early(Base):
    """Announces two early contacts at ping 0; at ping 3 one has become its contact and the other is withdrawn."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        events = super().feed(event)
        if not isinstance(event, Ping) or event.number not in (0, 3):
            return events
        first, second = (
            msgspec.structs.replace(contact(0), id=name, p_mine=0.6, next_look_deg=(90.0,))
            for name in ("E00001", "E00002")
        )
        if event.number == 0:
            return [*events, *(EarlyContact(contact=each, state="found") for each in (first, second))]
        became = EarlyContact(contact=first, state="became", became="C0003")
        return [*events, became, EarlyContact(contact=second, state="withdrawn")]


class _Once(Base):
    """Gets a signal at ping 5, once per file that FAILED_ONCE names."""

    number = signal.SIGKILL

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        if isinstance(event, Ping) and event.number == 5:
            self.fail()
        return super().feed(event)

    def fail(self) -> None:
        with contextlib.suppress(FileExistsError):
            os.close(os.open(os.environ["FAILED_ONCE"], os.O_CREAT | os.O_EXCL))
            os.kill(os.getpid(), self.number)


class DyingOnce(_Once):
    """Is killed once."""


class DyingOnceAndOnceAtItsStart(_Once):
    """Is killed once, and the next one before it has started."""

    def __init__(self, config: Config, kept: Contacts) -> None:
        if os.path.exists(os.environ["FAILED_ONCE"]) and not os.path.exists(mark := os.environ["FAILED_ONCE"] + "-2"):
            os.mkdir(mark)
            os.kill(os.getpid(), signal.SIGKILL)
        super().__init__(config, kept)


class HangingOnce(_Once):
    """Stops for good, once."""

    number = signal.SIGSTOP


class HangingWhileItAnswersOnce(_Once):
    """Stops for good in the middle of an answer, once."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        events = Base.feed(self, event)
        if isinstance(event, Ping) and event.number == 5 and not os.path.exists(os.environ["FAILED_ONCE"]):
            return [*events, _Large(code="large", text="")]
        return events


class _Large(Notice, frozen=True):
    """Takes far more bytes than a pipe holds, and stops its process once some of them are written."""

    def __reduce__(self) -> tuple[Any, ...]:
        threading.Thread(target=_stop_while_writing, args=(threading.get_ident(),)).start()
        return bytes, (bytes(1 << 26),)


def _stop_while_writing(thread: int) -> None:
    while sys._current_frames()[thread].f_code.co_name != "_send":
        time.sleep(0.0)
    os.close(os.open(os.environ["FAILED_ONCE"], os.O_CREAT | os.O_EXCL))
    os.kill(os.getpid(), signal.SIGSTOP)


class HangingAtItsStartOnce(_Once):
    """Stops for good before it has started, once."""

    number = signal.SIGSTOP

    def __init__(self, config: Config, kept: Contacts) -> None:
        self.fail()
        super().__init__(config, kept)


class DyingAtItsEndOnce(_Once):
    """Is killed once at the end of the mission."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        return Base.feed(self, event)

    def finish(self) -> list[PipelineEvent]:
        self.fail()
        return super().finish()


class DyingOverAPlanOnce(Undecided, _Once):
    """Is killed once, when a plan is requested or at ping 5."""

    def asking(self, min_p_mine: float) -> tuple[Contact, ...]:
        self.fail()
        return super().asking(min_p_mine)
