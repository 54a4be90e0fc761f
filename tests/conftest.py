"""Shared by all tests: reproducible property tests, how much to ask of slow kernels, and the folder of recorded
data."""

from __future__ import annotations

import asyncio
import gc
import inspect
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

from auv_mcm import kernels

settings.register_profile("reproducible", derandomize=True, deadline=None, max_examples=40)
settings.load_profile("reproducible")


@pytest.hookimpl(tryfirst=True)
def pytest_collection() -> None:
    """Collect the tests without looking for garbage: they all stay, and it took a quarter of the time."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Look for garbage again, but not among the tests."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that is a coroutine in an event loop of its own."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    names = inspect.signature(pyfuncitem.obj).parameters
    asyncio.run(pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in names}))
    return True


SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def n_runs() -> Callable[[int, int], int]:
    """The first number where the C kernels are built, the second where their twins serve, which say the same many times
    slower."""
    return lambda with_c, with_twins: with_c if kernels.backend() == "c" else with_twins


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Path of a recorded file beside the checkout, by its name in the data folder.

    Skips the test where the folder is absent; a file missing from a folder that is there is an error.
    """

    def path_of(name: str) -> Path:
        if not SHARED_DATA.is_dir():
            pytest.skip(f"needs recorded data {name}: the folder shared/data beside the checkout is absent")
        path = SHARED_DATA / name
        assert path.exists(), f"shared/data is there, but {name} is not in it"
        return path

    return path_of


@pytest.fixture
def without_perception(monkeypatch: pytest.MonkeyPatch) -> None:
    """`auv-mcm check` without a perception process, which takes a second of a core to start each time."""
    from auv_mcm.shell.check.finding import Finding

    found = Finding("perception process", "ok", "not started")
    monkeypatch.setattr("auv_mcm.shell.check._perception", lambda config: [found])
