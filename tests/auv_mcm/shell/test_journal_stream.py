"""Lines for systemd's journal begin with their priority, and only where they go there."""

from __future__ import annotations

import io
import logging
import os
import sys
from pathlib import Path

import pytest

from auv_mcm.shell.journal_stream import JournalFormatter, is_journal, journal_console


def test_a_stream_is_the_journal_where_systemd_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open(tmp_path / "stream", "w") as stream:
        monkeypatch.delenv("JOURNAL_STREAM", raising=False)
        assert not is_journal(stream)
        found = os.fstat(stream.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{found.st_dev}:{found.st_ino}")
        assert is_journal(stream)
        assert not is_journal(io.StringIO())
    with open(tmp_path / "redirected", "w") as other:
        assert not is_journal(other)


@pytest.mark.parametrize(
    ("level", "priority"),
    [(logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6), (logging.DEBUG, 7)],
)
def test_each_line_has_the_priority_of_its_record_and_no_time(level: int, priority: int) -> None:
    try:
        raise ValueError("two\nlines")
    except ValueError:
        record = logging.LogRecord("x", level, "x.py", 1, "a \x1b %s", ("word",), sys.exc_info())
    first, *others = JournalFormatter().format(record).split("\n")
    assert first == f"<{priority}>a \\x1b word"
    assert others
    assert [line for line in others if not line.startswith(f"<{priority}>  ")] == []


def test_notices_have_a_priority_of_their_own() -> None:
    lines: list[str] = []
    console = journal_console(lines.append)
    console("notice port_down: port 'x' is down")
    console("contact C0001 new: mine")
    assert lines == ["<5>notice port_down: port 'x' is down", "<6>contact C0001 new: mine"]
