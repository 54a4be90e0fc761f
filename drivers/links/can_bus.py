"""Open CAN buses with python-can: SocketCAN, and its virtual bus for unit tests."""

from __future__ import annotations

import asyncio
import contextlib
import errno
from collections import Counter
from typing import Any, Final

from auv_mcm.errors import HardwareError
from drivers.links.can_frame import CanFrame
from drivers.links.gather import GATHER_S

_MAX_PER_READ: Final = 256  # frames: bounds how long one read keeps the event loop
TO_CHECK: Final = "that the bus has power, its bit rate, its wires and its termination"
"""What a person should look at where nothing comes."""
_ERROR_BUS_OFF: Final = 0x40  # in the identifier of an error frame, linux/can/error.h


class CanBusPort:
    """Carry CAN frames on a bus of python-can.

    Its adapters raise all kinds of exceptions, and its notifiers swallow them; here any of them reports the bus as
    lost. counters: can.frames, can.sent, can.send_failed, can.error_frames, can.remote (frames without data, dropped).
    """

    def __init__(self, bus: Any, place: str, counters: Counter[str]) -> None:
        self.has_unsent = False
        self.pause_s = GATHER_S
        self.note = ""
        self._bus = bus
        self._place = place
        self._counters = counters
        self._has_errors = False  # since anything else came
        try:
            self._descriptor = int(bus.fileno())
        except NotImplementedError:
            self._descriptor = -1

    def fileno(self) -> int:
        return self._descriptor

    def read(self) -> list[CanFrame]:
        frames: list[CanFrame] = []
        for _ in range(_MAX_PER_READ):
            try:
                message = self._bus.recv(timeout=0)
            except Exception as error:
                raise HardwareError(_lost(self._place, error)) from error
            if message is None:
                break
            if message.is_error_frame:
                self._counters["can.error_frames"] += 1
                self._has_errors = True
                if message.arbitration_id & _ERROR_BUS_OFF:
                    channel = self._place.rpartition("/")[2]
                    raise HardwareError(
                        f"{self._place}: the controller switched itself off after too many errors. Check bit rate, "
                        f"wires and termination; then ip link set {channel} down and ip link set {channel} up type can "
                        "restart-ms 100 start it, and let it come back by itself."
                    )
                continue
            self._has_errors = False
            if message.is_remote_frame:
                self._counters["can.remote"] += 1
            else:
                self._counters["can.frames"] += 1
                frames.append(CanFrame(message.arbitration_id, bytes(message.data), message.is_extended_id))
        return frames

    def write(self, item: CanFrame) -> bool:
        import can

        try:
            self._bus.send(
                can.Message(arbitration_id=item.can_id, data=item.data, is_extended_id=item.extended, check=True),
                timeout=0,
            )
        except Exception:  # usually a full queue; a lost bus shows when it is read
            self._counters["can.send_failed"] += 1
            return False
        self._counters["can.sent"] += 1
        return True

    def flush(self) -> None:
        pass

    def on_silence(self) -> str:
        if self._has_errors:
            return (
                "Frames of errors came last: the bus has another bit rate, or its wires or its termination are wrong. "
                "Check them."
            )
        return f"Check {TO_CHECK}."

    def close(self) -> None:
        with contextlib.suppress(Exception):
            self._bus.shutdown()


async def open_can_bus(interface: str, channel: str, place: str, counters: Counter[str]) -> CanBusPort:
    """Open a bus of python-can. Raises HardwareError that says what to do."""

    def open_bus() -> Any:
        import can  # half a second

        return can.Bus(channel=channel, interface=interface, ignore_config=True)

    try:
        bus = await asyncio.to_thread(open_bus)
    except Exception as error:
        raise HardwareError(_lost(place, error)) from error
    return CanBusPort(bus, place, counters)


def _lost(place: str, error: Exception) -> str:
    channel = place.rpartition("/")[2]
    number = getattr(error, "errno", None) or getattr(error, "error_code", None)
    match number:
        case errno.ENODEV | errno.ENXIO:
            return (
                f"{place}: no such CAN interface. Plug in the adapter, or name another: ip -br link shows what is "
                "there."
            )
        case errno.ENETDOWN:
            return (
                f"{place}: the interface is down. Bring it up, e.g. ip link set {channel} up type can bitrate 250000."
            )
        case errno.EAFNOSUPPORT:
            return (
                f"{place}: this system has no SocketCAN. Load the kernel's can module, or use an adapter that speaks "
                "slcan."
            )
    return f"{place}: the CAN bus failed ({error}). Check the adapter; the bus is opened again as soon as it is back."
