"""Run the real service so that its power can be cut: note what is on the disk for certain, and leave no more.

`python -m sim_replay.hil.power_cut CONFIG NOTES` serves a configuration and writes into NOTES which file had how many
bytes each time it was synced. After a kill `cut_power` ends each file where a power cut may.
"""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path
from typing import Final

import numpy as np

from auv_mcm.clock import SystemClock
from auv_mcm.shell.recovery import JOURNAL, RECORDING, STATE

_GROWING: Final = (f"{RECORDING}*/*", f"{STATE}/events-*", f"{STATE}/records.bin", JOURNAL)
"""Files that are added to; others get their name once they are whole and on the disk."""
_TORN: Final = b'{"time":"2026-01-01T00:00:00Z","event":12,"cont'  # line of a journal


def note_syncs(notes: Path) -> None:
    """Write down the path and the size of each file that this process syncs from now on."""
    sync, noted = os.fsync, os.open(notes, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)

    def noting(descriptor: int) -> None:
        before = os.fstat(descriptor)
        sync(descriptor)
        if stat.S_ISREG(before.st_mode):
            os.write(noted, f"{before.st_size} {os.readlink(f'/proc/self/fd/{descriptor}')}\n".encode())

    os.fsync = noting  # type: ignore[assignment]


def cut_power(session: Path, notes: Path, random: np.random.Generator) -> int:
    """End each growing file of a killed session anywhere behind what was synced; return the bytes that went.

    The journal, whose lines are synced one by one, gets a line of which the end is missing.
    """
    lines = notes.read_text("utf-8").splitlines() if notes.exists() else []
    synced = {path: int(n_bytes) for n_bytes, _, path in (line.partition(" ") for line in lines)}
    n_gone = 0
    for path in sorted(path for pattern in _GROWING for path in session.glob(pattern) if path.is_file()):
        n_bytes = path.stat().st_size
        kept = int(random.integers(min(synced.get(str(path.resolve()), 0), n_bytes), n_bytes + 1))
        os.truncate(path, kept)
        n_gone += n_bytes - kept
    with (session / JOURNAL).open("ab") as file:
        file.write(_TORN[: int(random.integers(0, len(_TORN)))])
    return n_gone


def main(config: str, notes: str) -> int:
    """Run the service, noting what it syncs."""
    from auv_mcm.commands import read_config
    from auv_mcm.commands.run import run_service

    note_syncs(Path(notes))
    return run_service(read_config(Path(config)), SystemClock())


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
