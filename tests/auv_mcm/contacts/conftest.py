"""A record file for each test of contacts on disk."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from auv_mcm.contacts.record_file import RecordFile
from tests.auv_mcm.contacts.temporary_records import temporary_record_file


@pytest.fixture
def records(tmp_path: Path) -> Iterator[RecordFile]:
    with closing(temporary_record_file(tmp_path)) as records:
        yield records
