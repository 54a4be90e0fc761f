"""Tasks on one core, in processes and on a dask cluster of real processes: the same results in the same order, and
plain words if not."""

from __future__ import annotations

import os
import shutil
import socket
import time
from collections.abc import Iterator
from operator import neg
from pathlib import Path

import pytest

from auv_mcm.errors import HardwareError, UsageError
from sim_replay.fitting.cascade.farm import Farm, fingerprint, run_tasks
from tests.dask_cluster import ROOT, Cluster, dask_cluster


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    with dask_cluster(tmp_path) as started:
        yield started


def test_results_in_processes_are_those_of_one_core_in_order() -> None:
    tasks = list(range(7))
    reported: list[int] = []
    assert list(run_tasks(neg, tasks, Farm())) == [-task for task in tasks]
    assert list(run_tasks(neg, tasks, Farm(workers=2), reported.append)) == [-task for task in tasks]
    assert reported == [1, 2, 3, 4, 5, 6, 7]


def test_no_task_is_begun_before_its_turn_on_one_core() -> None:
    begun: list[int] = []
    results = run_tasks(begun.append, [1, 2, 3], Farm())
    next(results)
    assert begun == [1]


@pytest.mark.parametrize("workers", [1, 2])
def test_an_exception_of_a_task_is_raised_in_its_turn(workers: int) -> None:
    results = run_tasks(int, ["1", "2", "three", "4"], Farm(workers=workers))
    assert [next(results), next(results)] == [1, 2]
    with pytest.raises(ValueError, match="three"):
        next(results)
    assert list(results) == []


def test_a_process_that_dies_is_reported_in_plain_words() -> None:
    with pytest.raises(HardwareError, match=r"a worker process died.*fewer workers"):
        list(run_tasks(os._exit, [1, 1], Farm(workers=2)))


def test_no_tasks_give_no_results() -> None:
    assert list(run_tasks(neg, [], Farm(workers=2))) == []


@pytest.mark.parametrize(
    ("farm", "message"),
    [
        (Farm(workers=0), "workers: 0; at least 1"),
        (Farm(scheduler="localhost:8786"), "tcp://HOST:PORT"),
        (Farm(scheduler="tcp://localhost"), "tcp://HOST:PORT"),
        (Farm(scheduler="tcp://localhost:many"), "tcp://HOST:PORT"),
    ],
)
def test_what_is_no_farm_is_refused_at_once(farm: Farm, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        run_tasks(neg, [1], farm)


def test_a_scheduler_that_does_not_answer_is_reported_with_a_remedy() -> None:
    pytest.importorskip("distributed", reason="distributed, which runs clusters, is not installed")
    with socket.socket() as taken:  # bound, but nobody listens
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(HardwareError, match=f"{address} does not answer.*dask scheduler"):
            list(run_tasks(neg, [1], Farm(scheduler=address)))


def test_a_cluster_of_two_gives_the_same_results_in_order_raises_what_a_task_raises_and_outlives_a_worker(
    cluster: Cluster,
) -> None:
    doomed, _ = cluster.worker(), cluster.worker()
    farm = Farm(scheduler=cluster.address)
    assert list(run_tasks(neg, list(range(20)), farm)) == [-task for task in range(20)]
    with pytest.raises(ValueError, match="three"):
        list(run_tasks(int, ["1", "three"], farm))
    given_up = run_tasks(neg, list(range(20)), farm)
    assert next(given_up) == 0
    given_up.close()  # giving up half way must leave nothing behind
    results = run_tasks(time.sleep, [0.2] * 12, farm)
    assert next(results) is None
    doomed.kill()  # its tasks are done by the other
    assert [next(results) for _ in range(6)] == [None] * 6
    cluster.scheduler.kill()
    with pytest.raises(HardwareError, match="the connection was lost"):
        list(results)


def test_a_worker_with_other_sources_is_refused(cluster: Cluster, tmp_path: Path) -> None:
    for package in ("auv_mcm", "sim_replay"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    with (tmp_path / "sim_replay" / "fitting" / "cascade" / "__init__.py").open("a") as file:
        file.write("# a line more\n")
    cluster.worker(tmp_path)
    with pytest.raises(UsageError, match=f"worker tcp.* has auv_mcm sources .*here {fingerprint()['auv_mcm sources']}"):
        list(run_tasks(neg, [1], Farm(scheduler=cluster.address)))
