"""Run many independent tasks on this computer's cores or a dask cluster: the same results in the same order.

Tasks and results travel as pickles, functions by name: a cluster's workers need this package to the same line of
source, and the same numpy. Start them with one thread each: `dask worker --nthreads 1 --nworkers 4 tcp://HOST:8786`.
"""

from __future__ import annotations

import asyncio
import hashlib
import sys
import time
import uuid
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar
from urllib.parse import urlsplit

from auv_mcm.errors import HardwareError, UsageError

Task = TypeVar("Task")
Result = TypeVar("Result")

AHEAD: Final = 2
"""Tasks under way per worker, so that none waits for whoever takes the results."""
_CONNECT_S: Final = 10.0  # s for the scheduler to answer
_POLL_S: Final = 1.0  # s between looks at a task
_ALONE_S: Final = 30.0  # how long a cluster may be without any worker
_PACKAGES: Final = ("auv_mcm", "sim_replay")
_SOURCES: Final = frozenset({".py", ".c", ".json", ".yaml"})


class Farm(NamedTuple):
    """Choose where tasks run: in `workers` processes of this computer, in this very one if 1.

    Or on the cluster of a dask `scheduler`.
    """

    workers: int = 1
    scheduler: str | None = None


def run_tasks(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    farm: Farm,
    progress: Callable[[int], None] = lambda done: None,
) -> Generator[Result, None, None]:
    """Yield the result of `function`, of a module's top level, for each task, in the order of `tasks`.

    Results come one by one, and no more tasks are begun than keep the workers busy until the next is taken, so that few
    results are in memory. progress: called with the number of results before each is handed out. An exception of a task
    is raised in its turn and ends all; so does closing the iterator. Raises UsageError for workers below 1, a scheduler
    that is no tcp://HOST:PORT, and a cluster of other versions; HardwareError for a scheduler that does not answer or
    is lost, for a cluster that has no workers for half a minute, and for workers that die of a task.
    """
    if farm.workers < 1:
        raise UsageError(f"workers: {farm.workers}; at least 1")
    if farm.scheduler is not None:
        results = _on_cluster(function, tasks, _checked(farm.scheduler))
    elif farm.workers == 1 or len(tasks) < 2:
        results = (function(task) for task in tasks)
    else:
        results = _in_processes(function, tasks, min(farm.workers, len(tasks)))
    return _counted(results, progress)


def _counted(results: Generator[Result, None, None], progress: Callable[[int], None]) -> Generator[Result, None, None]:
    with closing(results):
        for done, result in enumerate(results, 1):
            progress(done)
            yield result


def _in_processes(
    function: Callable[[Task], Result], tasks: Sequence[Task], workers: int
) -> Generator[Result, None, None]:
    waiting = iter(tasks)
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    try:
        ahead = deque(pool.submit(function, task) for task in islice(waiting, AHEAD * workers))
        while ahead:
            result = ahead.popleft().result()
            ahead += [pool.submit(function, task) for task in islice(waiting, 1)]
            yield result
    except BrokenProcessPool as error:
        raise HardwareError(
            "a worker process died, perhaps for lack of memory. Run again with fewer workers"
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


def _on_cluster(
    function: Callable[[Task], Result], tasks: Sequence[Task], scheduler: str
) -> Generator[Result, None, None]:
    killed_worker = _distributed(scheduler).KilledWorker
    run = uuid.uuid4().hex  # keeps tasks of different runs apart on the scheduler
    waiting = enumerate(tasks)
    with _client(scheduler) as client:
        workers = _same_code(client, scheduler)

        def begin(n_tasks: int) -> list[Any]:
            return [
                client.submit(function, task, key=f"task-{run}-{k}", pure=False) for k, task in islice(waiting, n_tasks)
            ]

        try:
            ahead = deque(begin(AHEAD * workers))
            while ahead:
                result = _result(client, ahead.popleft(), scheduler)
                ahead += begin(1)
                yield result
        except killed_worker as error:
            raise HardwareError(
                f"scheduler {scheduler}: workers died again and again of one task, perhaps for lack of memory. See "
                "their logs"
            ) from error
        except (CancelledError, OSError) as error:
            if client.status == "running" and isinstance(error, OSError):
                raise
            raise HardwareError(
                f"scheduler {scheduler}: the connection was lost. See its log, then run again"
            ) from error


def _result(client: Any, future: Any, scheduler: str) -> Any:
    """Wait for a result as long as there are workers."""
    last_s = time.monotonic()
    while True:
        try:
            future.exception(timeout=_POLL_S)  # returns what the task raised: what is raised here is the wait's own
        except TimeoutError:
            if client.status != "running" or client.scheduler_info()["workers"]:
                last_s = time.monotonic()
            elif time.monotonic() - last_s > _ALONE_S:
                raise HardwareError(
                    f"scheduler {scheduler}: no workers are left. Start some with: dask worker {scheduler}"
                ) from None
        else:
            return future.result()


def _checked(scheduler: str) -> str:
    try:
        parts = urlsplit(scheduler)
        complete = parts.scheme == "tcp" and bool(parts.hostname) and parts.port is not None
    except ValueError:
        complete = False
    if not complete:
        raise UsageError(
            f"scheduler '{scheduler}' is not an address. Give it as tcp://HOST:PORT, which `dask scheduler` prints "
            "when it starts"
        )
    return scheduler


def _distributed(scheduler: str) -> Any:
    """Import dask's library, which is optional and untyped."""
    try:
        return import_module("distributed")
    except ImportError as error:
        raise UsageError(
            f"scheduler {scheduler}: dask is not installed here. Install it with: pip install 'auv-mcm[bench,cluster]'"
        ) from error


@contextmanager
def _client(scheduler: str) -> Iterator[Any]:
    distributed = _distributed(scheduler)
    try:
        # A client that cannot connect leaves its thread behind; asking first leaves nothing.
        asyncio.run(_greet(distributed, scheduler))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # versions are compared here, with words on what to do
            client = distributed.Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError, KeyError, TypeError) as error:
        raise HardwareError(
            f"scheduler {scheduler} does not answer as a dask scheduler within {_CONNECT_S:g} s. Start one with `dask "
            "scheduler`, and check host, port and firewall; without a scheduler tasks run on this computer"
        ) from error
    try:
        yield client
    finally:
        client.close()


async def _greet(distributed: Any, scheduler: str) -> None:
    address = urlsplit(scheduler)
    _, writer = await asyncio.wait_for(asyncio.open_connection(address.hostname, address.port), _CONNECT_S)
    writer.close()  # a port where nobody listens fails at once; dask would retry
    await writer.wait_closed()
    async with distributed.rpc(scheduler, timeout=_CONNECT_S) as remote:
        identity = await asyncio.wait_for(remote.identity(n_workers=0), _CONNECT_S)
    if identity["type"] != "Scheduler":
        raise ValueError(identity["type"])


def _same_code(client: Any, scheduler: str) -> int:
    """Return the number of threads of all workers. Raises UsageError if one of them runs other code."""
    deadline_s = time.monotonic() + _ALONE_S
    while not (threads := client.nthreads()):
        if time.monotonic() > deadline_s:
            raise HardwareError(
                f"scheduler {scheduler} has no workers. Start some with: dask worker --nthreads 1 {scheduler}"
            )
        time.sleep(0.1)
    here = fingerprint()
    for worker, there in client.run(fingerprint, on_error="return").items():
        if isinstance(there, BaseException):
            raise UsageError(f"worker {worker} cannot run this package: {there}. Install it there as it is here")
        other = [f"{name} {there.get(name)} (here {value})" for name, value in here.items() if there.get(name) != value]
        if other:
            raise UsageError(
                f"worker {worker} has {', '.join(other)}. Install there what is installed here and start the worker "
                "again"
            )
    return sum(threads.values())


def fingerprint() -> dict[str, str]:
    """Return what must be the same wherever tasks run: versions, and a digest of this package's sources."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        spec = find_spec(package)
        folder = Path(str(spec and spec.origin)).parent
        for path in sorted(path for path in folder.rglob("*") if path.suffix in _SOURCES):
            digest.update(path.relative_to(folder.parent).as_posix().encode() + b"\0" + path.read_bytes())
    return {
        "python": f"{sys.version_info.major}.{sys.version_info.minor}",
        "numpy": version("numpy"),
        "distributed": version("distributed"),
        "auv_mcm sources": digest.hexdigest()[:12],
    }
