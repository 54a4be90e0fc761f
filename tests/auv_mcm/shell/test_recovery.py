"""Disk space held for the results is there, gets smaller on a small disk, and leaves nothing behind."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from auv_mcm.shell.recovery import Ballast


def test_ballast_is_space_on_the_disk_without_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[int] = []

    def allocate(descriptor: int, start: int, n_bytes: int, really: object = os.posix_fallocate) -> None:
        assert callable(really)
        really(descriptor, start, n_bytes)
        taken.append(os.fstat(descriptor).st_blocks * 512)

    monkeypatch.setattr("auv_mcm.shell.recovery.os.posix_fallocate", allocate)
    ballast = Ballast(tmp_path, 1 << 20)
    assert ballast.n_bytes == 1 << 20 <= taken[0]
    assert list(tmp_path.iterdir()) == []
    ballast.release()
    ballast.release()


def test_a_small_disk_gives_what_it_has_and_a_full_one_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def of_free(free_bytes: int) -> int:
        def allocate(descriptor: int, start: int, n_bytes: int) -> None:
            if n_bytes > free_bytes:
                raise OSError(28, "No space left on device")

        monkeypatch.setattr("auv_mcm.shell.recovery.os.posix_fallocate", allocate)
        ballast = Ballast(tmp_path, 1 << 20)
        ballast.release()
        return ballast.n_bytes

    assert [of_free(1 << 20), of_free(300_000), of_free(10_000)] == [1 << 20, 1 << 18, 0]
    assert Ballast(tmp_path / "not there").n_bytes == 0
