"""Record files that go with the test."""

from __future__ import annotations

import contextlib
import tempfile
from pathlib import Path

from auv_mcm.contacts.record_file import RecordFile


def temporary_record_file(folder: Path) -> RecordFile:
    """A record file without a name on the disk of a folder; it takes nothing where none can be opened."""
    with contextlib.suppress(OSError):
        return RecordFile(tempfile.TemporaryFile(dir=folder, buffering=0))
    return RecordFile(None)
