"""Recorded NMEA 2000 traffic: candump logs, canboat's analyser input and PCAN-View traces, as frames or whole
messages."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, NamedTuple

from drivers.navigation.n2k_messages import Identifier, can_id_of

_CANDUMP_LOG: Final = re.compile(r"\((\d+\.\d+)\) \S+ ([0-9A-F]{8})#((?:[0-9A-F]{2}){0,8})")
_CANDUMP_SCREEN: Final = re.compile(r"<0x([0-9a-f]{8})> \[(\d)\]((?: [0-9a-f]{2})*) ?")
_CANBOAT: Final = re.compile(
    r"(\d{4}-\d\d-\d\d[T-]\d\d:\d\d:\d\d\.\d{1,6})Z?,(\d),(\d+),(\d+),(\d+),(\d+)((?:,[0-9a-f]{2})+)", re.IGNORECASE
)
_PCAN_VIEW: Final = re.compile(r"\s*\d+\)\s+(\d+\.\d)\s+Rx\s+([0-9A-F]{8})\s+(\d) ((?: [0-9A-F]{2})*) ?")
_PCAN_START: Final = re.compile(r";\$STARTTIME=(\d+\.\d+)")
_PCAN_EPOCH_DAYS: Final = 25_569.0  # days from 1899-12-30, where PCAN counts from, to 1970


class RecordedMessage(NamedTuple):
    """time_s: UTC seconds since 1970; since the start of the log where it has no dates; NaN where it has no times.

    data: of a frame at most 8 bytes; longer ones are whole messages, whose fast packets the recorder put together.
    """

    time_s: float
    can_id: int
    data: bytes

    @property
    def is_whole(self) -> bool:
        return len(self.data) > 8


def read_can_log(path: Path, counters: Counter[str]) -> Iterator[RecordedMessage]:
    """What a log recorded, in its order, whichever of the formats it has.

    Counts can_log.lines_skipped: lines of none of them that are no comments either.
    """
    start_s = 0.0
    for text in path.read_text("ascii", "replace").splitlines():
        if (started := _PCAN_START.match(text)) is not None:
            start_s = (float(started[1]) - _PCAN_EPOCH_DAYS) * 86_400.0
        if not text.strip() or text[0] in "#;":
            continue
        message = _parse(text, start_s)
        if message is None:
            counters["can_log.lines_skipped"] += 1
        else:
            yield message


def _parse(text: str, start_s: float) -> RecordedMessage | None:
    if (match := _CANDUMP_LOG.fullmatch(text)) is not None:
        return RecordedMessage(float(match[1]), int(match[2], 16), bytes.fromhex(match[3]))
    if (match := _CANBOAT.fullmatch(text)) is not None:
        priority, pgn, source, destination, n_bytes = (int(match[group]) for group in range(2, 7))
        data = bytes.fromhex(match[7].replace(",", ""))
        if len(data) != n_bytes or pgn > 0x3FFFF:
            return None
        time_s = datetime.fromisoformat(f"{match[1][:10]}T{match[1][11:]}").replace(tzinfo=UTC).timestamp()
        return RecordedMessage(time_s, can_id_of(Identifier(priority, pgn, destination, source)), data)
    if (match := _PCAN_VIEW.fullmatch(text)) is not None:
        return _checked(start_s + float(match[1]) * 1e-3, match[2], match[3], match[4])
    if (match := _CANDUMP_SCREEN.fullmatch(text)) is not None:
        return _checked(float("nan"), match[1], match[2], match[3])
    return None


def _checked(time_s: float, can_id: str, n_bytes: str, data: str) -> RecordedMessage | None:
    message = RecordedMessage(time_s, int(can_id, 16), bytes.fromhex(data))
    return message if len(message.data) == int(n_bytes) else None
