"""Work as the perception process: feed the chain what the service sends, and answer what came of it."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from multiprocessing.connection import Connection
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm import errors
from auv_mcm.clean_text import clean_lines
from auv_mcm.contacts.record_file import RecordFile
from auv_mcm.memory import return_freed_memory
from auv_mcm.plan.look_again import PlanRequest
from auv_mcm.settings.config import Config
from auv_mcm.shell.checkpoint import Keeping
from auv_mcm.shell.perception_chain import MakePipeline, PerceptionChain
from auv_mcm.shell.perception_messages import Checkpointed, Failure, Planned, Reserve
from auv_mcm.shell.ping_ring import RingPing, out_of_ring

_NICENESS: Final = 5  # of the worker: where processors are few, ports come first, for pings wait and bytes do not
_PR_SET_PDEATHSIG: Final = 1  # prctl(2)


def work(
    connection: Connection,
    shared: ctypes.Array[ctypes.c_ubyte],
    config: Config,
    make_pipeline: MakePipeline,
    records: RecordFile,
    keeping: Keeping | None,
) -> None:
    """Run the worker process: serve the parent until it says that no event follows, and report how that failed.

    Parameters
    ----------
    shared
        The ring that samples of pings come through.
    records
        For contacts and coverage.
    keeping
        Where to go on from, and to leave checkpoints; None for neither.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    _end_with_parent()
    os.nice(_NICENESS)
    chain: PerceptionChain | None = None
    disk = ThreadPoolExecutor(1, "checkpoint")
    try:
        chain = PerceptionChain(config, make_pipeline, records, keeping)
        gc.collect()
        gc.freeze()
        _serve(connection, chain, np.frombuffer(memoryview(shared), np.uint8), disk)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        pass  # the parent is gone: no reader for an answer
    except errors.AuvMcmError as error:
        connection.send(Failure(type(error).__name__, str(error)))
    except Exception as error:
        print(clean_lines(traceback.format_exc()), file=sys.stderr)
        place = "at its start" if chain is None else chain.place
        why = f"{type(error).__name__}: {error}. This is a defect: report it with the log."
        connection.send(Failure("PerceptionError", f"perception failed ({place}): {why}"))
    finally:
        disk.shutdown()
        records.close()


def _serve(connection: Connection, chain: PerceptionChain, memory: NDArray[np.uint8], disk: ThreadPoolExecutor) -> None:
    """Answer each message, until None says that the mission has ended; then give the last answers.

    disk: writes checkpoints, so that no ping waits for them.
    """
    sending = threading.Lock()

    def send(answer: object) -> None:
        with sending:
            connection.send(answer)

    def keep(write: Callable[[], bool], number: int) -> None:
        if write():
            send(Checkpointed(number))

    send(chain.started)
    number = chain.started.number
    keeping: Future[None] = disk.submit(lambda: None)
    while (message := connection.recv()) is not None:
        if isinstance(message, PlanRequest):
            planned = Planned(chain.propose(message))
            if message.flown:  # no event gives these legs again
                wait([keeping])
                keep(chain.checkpoint(number), number)
            send(planned)
        elif isinstance(message, Reserve):
            chain.pipeline.reserve(message.n_contacts)
        else:
            number, event = message
            if isinstance(event, RingPing):
                chain.leave_room(event.room)
                event = out_of_ring(event, memory)
            answer = chain.feed(event)
            send(answer)
            chain.keep(answer.patches)
            if keeping.done() and chain.is_checkpoint_due(bool(answer.patches)):
                keeping = disk.submit(keep, chain.checkpoint(number), number)
                return_freed_memory()
    send(chain.finish())
    send(chain.last_answer())


def _end_with_parent() -> None:
    """Have the system end this process with the service: a new service goes on with the same files at once."""
    with contextlib.suppress(OSError, AttributeError):  # Linux alone has it
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
