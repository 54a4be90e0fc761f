"""Write the DBC file of the messages between payload and vehicle, from their table.

python -m drivers.vehicle.can_dbc > deploy/auv_mcm.dbc
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Final

from auv_mcm.settings.vehicle_settings import CanSettings
from drivers.vehicle import can_messages
from drivers.vehicle.can_messages import CRC16_BYTES, CRC32_BYTES, FRAME_BYTES, MESSAGES, CanMessage, can_id_of
from drivers.vehicle.can_signals import Signal

_EXTENDED: Final = 1 << 31  # marks identifiers of 29 bits in a DBC file
_NODES: Final = {"payload": "PAYLOAD", "vehicle": "VEHICLE"}
_PART: Final = Signal("part", 1, 0, 255, "which frame of the transfer this is")
_SEQUENCE: Final = Signal(
    "sequence", 1, 0, 255, "the same in all frames of a transfer, goes on by 1 with the next, repetitions too"
)
_CRC16: Final = Signal(
    "crc", CRC16_BYTES, 0, 0xFFFF, "CRC-16/IBM-3740 of message number, sender's address and bytes 0 to 5"
)
_CRC32: Final = Signal(
    "crc",
    CRC32_BYTES,
    0,
    0xFFFFFFFF,
    "CRC-32/ISO-HDLC of message number, sender's address and bytes 2 to 7 of all parts in order, but for the crc",
)
_NOT_AVAILABLE: Final = "not available"


def dbc_text() -> str:
    """Return the whole file.

    Identifiers have the addresses that are the default; another address changes their last byte.
    """
    settings = CanSettings()
    address = {"payload": settings.payload_address, "vehicle": settings.vehicle_address}
    ids = {message.number: can_id_of(message, address[message.sender]) | _EXTENDED for message in MESSAGES}
    lines = ['VERSION ""', "", "NS_ :", "", "BS_:", "", f"BU_: {' '.join(_NODES.values())}", ""]
    for message in MESSAGES:
        lines.append(f"BO_ {ids[message.number]} {message.name}: {FRAME_BYTES} {_NODES[message.sender]}")
        lines += [_signal_line(signal, first_byte, mark, message) for signal, first_byte, mark in _signals(message)]
        lines.append("")
    lines.append(f"CM_ {_quoted(can_messages.__doc__ or '')};")
    for message in MESSAGES:
        lines.append(f"CM_ BO_ {ids[message.number]} {_quoted(message.comment)};")
        lines += [
            f"CM_ SG_ {ids[message.number]} {signal.name} {_quoted(_comment(signal))};"
            for signal, _, _ in _signals(message)
        ]
    lines += ['BA_DEF_ BO_ "GenMsgCycleTime" INT 0 60000;', 'BA_DEF_DEF_ "GenMsgCycleTime" 0;']
    lines += [
        f'BA_ "GenMsgCycleTime" BO_ {ids[message.number]} {round(1e3 * message.period_s)};'
        for message in MESSAGES
        if message.period_s
    ]
    for message in MESSAGES:
        for signal, _, _ in _signals(message):
            named = dict(enumerate(signal.names)) if signal.scale is None else {signal.unavailable: _NOT_AVAILABLE}
            if named:
                named_values = " ".join(f"{value} {_quoted(name)}" for value, name in named.items())
                lines.append(f"VAL_ {ids[message.number]} {signal.name} {named_values} ;")
    return "\n".join(lines) + "\n"


def _signals(message: CanMessage) -> Iterator[tuple[Signal, int, str]]:
    """List every signal with head and CRC, its first byte, and its mark.

    M for the part number, m1 for a signal of part 1.
    """
    if not message.is_transfer:
        for placed in message.placed:
            yield placed.signal, placed.first_byte, ""
        yield _CRC16, FRAME_BYTES - CRC16_BYTES, ""
        return
    last = len(message.parts) - 1
    yield _PART._replace(high=last), 0, "M "
    yield _SEQUENCE, _PART.n_bytes, ""
    for part, first_byte, signal in message.placed:
        yield signal, first_byte, f"m{part} "
    yield _CRC32, FRAME_BYTES - CRC32_BYTES, f"m{last} "


def _signal_line(signal: Signal, first_byte: int, mark: str, message: CanMessage) -> str:
    receiver = _NODES["vehicle" if message.sender == "payload" else "payload"]
    sign = "-" if signal.signed else "+"
    scale = 1 if signal.scale is None else signal.scale
    bounds = f"[{signal.low:.12g}|{signal.high:.12g}]"
    return (
        f" SG_ {signal.name} {mark}: {8 * first_byte}|{8 * signal.n_bytes}@1{sign} ({scale:g},0) {bounds} "
        f'"{signal.unit}" {receiver}'
    )


def _comment(signal: Signal) -> str:
    return signal.comment if signal.scale is None else f"{signal.comment}. Not available: {signal.unavailable}"


def _quoted(text: str) -> str:
    return '"' + text.strip().replace('"', "'") + '"'


if __name__ == "__main__":
    sys.stdout.write(dbc_text())
