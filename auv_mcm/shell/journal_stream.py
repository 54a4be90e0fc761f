"""Write lines for the journal of systemd: with the priority in front, which it strips, and without the time."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from typing import Final, TextIO

from auv_mcm.clean_text import CleanFormatter

_PRIORITIES: Final = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
"""Levels of the log, and from which on which priority of syslog(3) holds."""
_DEBUG: Final = 7  # priority of syslog(3) for what is below all of them
_NOTICE: Final = 5  # priority of syslog(3): significant, but no failure of the service
_INFO: Final = 6  # priority of syslog(3) for contacts


def is_journal(stream: TextIO) -> bool:
    """Find whether a stream goes to the journal: systemd states its device and inode (sd_journal_stream_fd(3))."""
    try:
        found = os.fstat(stream.fileno())
    except (OSError, ValueError):  # a stream without a descriptor
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"


class JournalFormatter(CleanFormatter):
    """Format log records for the journal, each of their lines with its priority."""

    def __init__(self) -> None:
        super().__init__("%(message)s")

    def format(self, record: logging.LogRecord) -> str:
        """Format a record."""
        priority = next((number for level, number in _PRIORITIES if record.levelno >= level), _DEBUG)
        return "\n".join(f"<{priority}>{line}" for line in super().format(record).split("\n"))


def journal_console(write: Callable[[str], None]) -> Callable[[str], None]:
    """Make a console for the journal: notices have its priority 'notice', so that journalctl -p notice finds them."""
    return lambda line: write(f"<{_NOTICE if line.startswith('notice ') else _INFO}>{line}")
