"""Open serial ports: pyserial opens and configures them, the event loop reads them."""

from __future__ import annotations

import asyncio
import errno
import termios
from collections import Counter
from typing import Any

from auv_mcm.errors import HardwareError
from drivers.links.gather import gather_s
from drivers.links.stream import StreamPort


async def open_serial(path: str, baud: int, counters: Counter[str]) -> StreamPort:
    """Open a port for this process alone, 8N1, no flow control; its modem lines are left as the kernel sets them.

    Raises HardwareError that says what to do.
    """
    # Some USB adapters take seconds to open. A port that opens after this was cancelled is closed by its own finaliser.
    opened = await asyncio.to_thread(_open, path, baud)

    def lost(error: OSError | None) -> str:
        how = "hung up" if error is None or error.errno == errno.EIO else f"failed ({error.strerror})"
        return (
            f"{path}: the port {how}. Check the cable and the device's power; it is opened again as soon as it is back."
        )

    def on_silence() -> str:
        return f"Check the cable, the device's power, and that it is set to {baud} baud."

    return StreamPort(opened.fd, opened.close, lost, on_silence, gather_s(baud), counters)


def _open(path: str, baud: int) -> Any:
    import serial

    port: Any = serial.Serial(baudrate=baud, timeout=0, write_timeout=0, exclusive=True)
    port.port = path
    # pyserial raises both lines when it opens; they may be wired to a reset input or an RS-485 transmitter.
    port._update_dtr_state = port._update_rts_state = lambda: None
    try:
        port.open()
        attributes = termios.tcgetattr(port.fd)
        # With 0, as pyserial has it, a port that has nothing reads as one that hung up.
        attributes[6][termios.VMIN] = 1
        termios.tcsetattr(port.fd, termios.TCSANOW, attributes)
        is_set = attributes[4:6] == [getattr(termios, f"B{baud}")] * 2
    except (OSError, ValueError, termios.error) as error:  # pyserial lets all three through
        raise HardwareError(_refusal(path, error)) from error
    if not is_set:  # drivers that cannot do a rate keep another and do not report it
        port.close()
        raise HardwareError(f"{path}: the port does not take {baud} baud. Choose a rate that both ends support.")
    return port


def _refusal(path: str, error: Exception) -> str:
    match error.errno if isinstance(error, OSError) else error.args[0]:  # of termios.error, its number
        case errno.ENOENT:
            return (
                f"{path}: no such device. Plug it in and switch it on, or name another: ls -l /dev/serial/by-id shows "
                "what is there."
            )
        case errno.EACCES | errno.EPERM:
            return (
                f"{path}: permission denied. Add the user of this service to the group that ls -l {path} shows, "
                "usually dialout."
            )
        case errno.EAGAIN | errno.EBUSY:
            return f"{path}: in use by another program. Stop that one: fuser -v {path} shows which it is."
        case errno.ENODEV | errno.ENXIO | errno.EIO:
            return f"{path}: the port does not answer ({error}). Check the adapter and its power."
    return (
        f"{path}: cannot be used as a serial port ({error}). Name a serial device: ls -l /dev/serial/by-id shows what "
        "is there."
    )
