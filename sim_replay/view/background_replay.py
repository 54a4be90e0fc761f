"""Replay logs in a process of their own while the page shows them, contacts as they are found."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from ctypes import c_double
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from auv_mcm.contacts.contact import best_view
from auv_mcm.contacts.contact_picture import snippet_png
from auv_mcm.contacts.export import contact_feature
from auv_mcm.errors import AuvMcmError
from auv_mcm.records import Contact
from auv_mcm.settings.config import Config
from auv_mcm.shell.journal import Journal
from auv_mcm.shell.snippet_files import Snippets, make_results_directory
from sim_replay.view.mission_files import CONTACTS, JOURNAL, SUMMARY

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

_NICENESS: Final = 5  # so that the page stays quick on a computer of two cores
_STOP_S: Final = 5.0  # s that a process has to end in, before it is killed


class BackgroundReplay:
    """Replay logs into a folder of results, and know how far it is."""

    def __init__(self, logs: Sequence[Path], folder: Path, config: Config) -> None:
        """Prepare; nothing runs before `start`."""
        context = get_context("spawn")
        self.folder = folder
        self._fraction: Any = context.RawValue(c_double, 0.0)  # a lock would outlive a process that is killed
        self._answer, sends = context.Pipe(duplex=False)
        self._problem = ""
        self._sends = sends
        self._process = context.Process(
            target=_replay_into, args=(list(logs), folder, config, self._fraction, sends), daemon=True
        )

    def start(self) -> None:
        """Begin, with a folder that holds no results of an earlier replay. Raises OSError, UsageError."""
        make_results_directory(self.folder)
        for name in (SUMMARY, CONTACTS, JOURNAL):
            (self.folder / name).unlink(missing_ok=True)
        self._process.start()
        self._sends.close()

    @property
    def fraction_done(self) -> float:
        """Return how much of the logs was searched, 0..1."""
        return float(self._fraction.value)

    @property
    def problem(self) -> str:
        """Say why it ended early, "" as long as it did not."""
        with contextlib.suppress(EOFError, OSError):
            while self._answer.poll():
                self._problem = str(self._answer.recv())
        if self._problem or self.is_running or (self.folder / SUMMARY).exists():
            return self._problem
        return "its process died, perhaps for lack of memory: replay the log by itself" if self._process.pid else ""

    @property
    def is_running(self) -> bool:
        """Find whether it still runs."""
        return self._process.is_alive()

    def join(self) -> None:
        """Wait for its end."""
        self._process.join()

    def close(self) -> None:
        """End it, finished or not."""
        if self._process.pid is None:
            return
        self._process.terminate()
        self._process.join(_STOP_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _replay_into(logs: list[Path], folder: Path, config: Config, fraction: Any, answer: Connection) -> None:
    """Replay, in the process of its own; write each contact as soon as it is found, and remove that list at the end."""
    from sim_replay.replay import replay

    def show(done: float) -> None:
        fraction.value = done

    os.nice(_NICENESS)
    try:
        found = _FoundContacts(folder)
        replay(logs, folder, config, progress=show, found=found.add)
        found.close()
        fraction.value = 1.0
    except (AuvMcmError, OSError) as error:
        answer.send(str(error))
    except KeyboardInterrupt:
        pass  # of the page, which says so


class _FoundContacts:
    """Write contacts to a journal and their pictures as they come."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._journal = Journal(folder / JOURNAL)
        self._snippets = Snippets(folder)

    def add(self, contact: Contact) -> None:
        view = best_view(contact)
        if view is not None:
            self._snippets.write({contact.id: snippet_png(view)})
        self._journal.append([{"contact": contact_feature(contact)}])

    def close(self) -> None:
        self._journal.close()
        (self._folder / JOURNAL).unlink(missing_ok=True)
