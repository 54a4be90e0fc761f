"""Run a fake device as a process of its own: python -m sim_replay.fakes JOB.yaml

A JOB with `devices` is a vehicle with all that is aboard; each of its lines then names the device.

It reports events in lines of JSON on standard output, first `ready` with the address of its wire. It begins at the
instant that a line `start SECONDS` on standard input names (of the monotonic clock, which all processes share), or at
once with --now. A line `hold SECONDS` delays all that is still due by so much; `hang_up 0` states that the host's
program has ended. A JOB that `waits` waits by itself where the device is late, and reports `held` with for_s, for other
devices to wait as well. It ends, leaving no port behind, when standard input ends, on SIGTERM or SIGINT, and with --now
when its mission is over.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from auv_mcm.clean_text import clean_lines
from auv_mcm.commands import Parser
from auv_mcm.errors import AuvMcmError, UsageError
from sim_replay.fakes.device import FakeDevice
from sim_replay.fakes.feed import mission_events, read_ahead, time_line
from sim_replay.fakes.job import VehicleJob, read_job

if TYPE_CHECKING:
    from sim_replay.fakes.vehicle_device import FakeVehicle

_SETTLE_S: Final = 0.3  # for the host to open the port
_WAITS_AFTER_S: Final = 0.25  # s; as long as a device of its own may be late where the mission does not wait


def main() -> int:
    """Play a mission as one device on a port."""
    parser = Parser(prog="python -m sim_replay.fakes", description="Play a mission as one device on a port.")
    parser.add_argument(
        "job",
        metavar="JOB",
        type=Path,
        help="YAML: name, folder, device, log or scene, ...; or devices, folder, scene, ...",
    )
    parser.add_argument("--now", action="store_true", help="begin at once instead of at a start line on standard input")
    arguments = parser.parse_args()
    failed: list[BaseException] = []
    try:
        with contextlib.suppress(asyncio.CancelledError):  # requested to stop
            asyncio.run(_serve(arguments.job, arguments.now))
    except* AuvMcmError as group:
        failed = list(_leaves(group))
    for error in failed:
        print(clean_lines(f"fake device: {error}"), file=sys.stderr)
    return max((error.exit_code for error in failed if isinstance(error, AuvMcmError)), default=0)


def _leaves(error: BaseException) -> Iterator[BaseException]:
    """Yield the errors in a group of groups."""
    if isinstance(error, BaseExceptionGroup):
        for inner in error.exceptions:
            yield from _leaves(inner)
    else:
        yield error


async def _serve(path: Path, now: bool) -> None:
    job = read_job(path)
    device: FakeDevice | FakeVehicle
    if isinstance(job, VehicleJob):
        from sim_replay.fakes.vehicle_device import FakeVehicle  # with the simulator, which no recorded mission needs

        device = FakeVehicle(job, lambda name, what, details: _report(what, {"device": name, **details}))
    else:
        log = None if job.log is None else Path(job.log)
        events = read_ahead(time_line(mission_events(log, job.scene), job.speed))
        wait = (lambda late_s: _hold(device, late_s)) if job.waits else None
        device = FakeDevice(job, events, _report, wait=wait, waits_after_s=_WAITS_AFTER_S)
    serving = asyncio.ensure_future(_played_now(device) if now else _play_as_commanded(device))
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, serving.cancel)
    try:
        await serving
    finally:
        await device.end()


async def _played_now(device: FakeDevice | FakeVehicle) -> None:
    start: asyncio.Future[float] = asyncio.get_running_loop().create_future()
    start.set_result(time.monotonic() + _SETTLE_S)
    await device.run(start)


async def _play_as_commanded(device: FakeDevice | FakeVehicle) -> None:
    """Play until standard input ends, even if the mission ends before."""
    commands = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(commands), sys.stdin)
    start: asyncio.Future[float] = asyncio.get_running_loop().create_future()
    playing = asyncio.ensure_future(device.run(start))
    listening = asyncio.ensure_future(_listen(commands, start, device))
    try:
        await asyncio.wait({playing, listening}, return_when=asyncio.FIRST_COMPLETED)
        if not listening.done():
            playing.result()
        await listening
    finally:
        for task in (playing, listening):
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task


async def _listen(
    commands: asyncio.StreamReader, start: asyncio.Future[float], device: FakeDevice | FakeVehicle
) -> None:
    while line := await commands.readline():
        word, _, seconds = line.decode("ascii", "replace").partition(" ")
        try:
            if word == "hold" and start.done() and isinstance(device, FakeDevice):
                device.hold(float(seconds))
            elif word == "hang_up":
                for wire in [device.wire] if isinstance(device, FakeDevice) else device.wires:
                    wire.hang_up()
            elif word == "start" and not start.done():
                start.set_result(float(seconds))
            else:
                raise ValueError
        except ValueError:
            raise UsageError(
                "standard input: expected one line 'start SECONDS', then lines 'hang_up 0', or 'hold SECONDS' for a "
                f"device that is no vehicle, got {line!r}"
            ) from None


def _hold(device: FakeDevice | FakeVehicle, late_s: float) -> None:
    """Let the mission of one device wait: what was due that long ago is due now."""
    assert isinstance(device, FakeDevice)
    device.hold(late_s)
    _report("held", {"for_s": round(late_s, 4)})


def _report(what: str, details: dict[str, Any]) -> None:
    with contextlib.suppress(BrokenPipeError):  # nobody reads it any more; the end of standard input ends the process
        print(json.dumps({"mono_s": round(time.monotonic(), 4), "what": what, **details}), flush=True)


if __name__ == "__main__":
    sys.exit(main())
