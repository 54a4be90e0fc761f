"""A dask cluster of real processes on loopback, for tests."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).resolve().parents[1]
PATIENCE_S: Final = 60.0  # s for the scheduler to begin


class Cluster:
    """A dask scheduler on loopback, and workers as they are started."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._folder, self._stack = folder, stack
        self._file = folder / "scheduler.json"
        self.scheduler = self._start(
            "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(self._file)
        )
        self.address = self._address()

    def _address(self) -> str:
        """Wait for the scheduler's file to be whole: dask does not write it in one step."""
        deadline_s = time.monotonic() + PATIENCE_S
        while True:
            try:
                return str(json.loads(self._file.read_text())["address"])
            except (FileNotFoundError, json.JSONDecodeError):
                assert time.monotonic() < deadline_s
                assert self.scheduler.poll() is None
                time.sleep(0.05)

    def worker(self, sources: Path = ROOT) -> subprocess.Popen[bytes]:
        options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1"]
        return self._start("worker", *options, self.address, sources=sources)

    def _start(self, *words: str, sources: Path = ROOT) -> subprocess.Popen[bytes]:
        environment = os.environ | {"PYTHONPATH": str(sources), "PYTHONWARNINGS": "default"}
        process = subprocess.Popen(
            [sys.executable, "-m", "dask", *words],
            cwd=self._folder,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)
        return process


@contextmanager
def dask_cluster(folder: Path) -> Iterator[Cluster]:
    """Start a scheduler that keeps its files in a folder; stop it and its workers in the end."""
    pytest.importorskip("distributed", reason="distributed, which runs clusters, is not installed")
    with ExitStack() as stack:
        yield Cluster(folder, stack)
