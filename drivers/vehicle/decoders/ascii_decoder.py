"""Decode sentences of a vehicle: the part that all text dialects share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from typing import Any

from auv_mcm.clock import Stamp
from auv_mcm.records import NAN
from drivers.framing import Grammar, StampedFramer
from drivers.vehicle.ascii_fields import Table
from drivers.vehicle.dialect import ReportedState, VehicleMessage, fix_of


class AsciiDecoder(ABC):
    """Decode one vehicle's sentences to records of its table; a subclass derives the vehicle's state from them.

    counters: NAME.messages, .bytes_skipped and .refused.REASON of the framer, .malformed (checksum right, fields
    impossible) and .ignored (kinds not known here).

    of_payload: kinds of records that the payload alone sends; a wire that echoes them is no vehicle that speaks.
    """

    of_payload: frozenset[type] = frozenset()

    def __init__(self, grammar: Grammar[str], table: Table, port: str) -> None:
        """port: name that fixes carry."""
        self._name = grammar.name
        self._framer = StampedFramer(grammar)
        self._table = table
        self._port = port
        self._own: Counter[str] = Counter()
        self.bus_counters: Counter[str] = Counter()

    @property
    def counters(self) -> Counter[str]:
        return self._framer.counters + self._own

    def feed(self, data: bytes, stamp: Stamp) -> list[VehicleMessage]:
        """Decode a chunk; see `VehicleDecoder.feed`."""
        return [self._message(body, received) for body, received, _ in self._framer.feed(data, stamp)]

    def _message(self, body: str, received: Stamp) -> VehicleMessage:
        try:
            record = self._table.parse(body)
        except (ValueError, OverflowError):
            self._own[f"{self._name}.malformed"] += 1
            return VehicleMessage(None, received)
        if record is None:
            self._own[f"{self._name}.ignored"] += 1
            return VehicleMessage(None, received)
        state = self._state(record, received)
        fixes = () if state is None else (fix_of(self._port, state),)
        return VehicleMessage(record, received, state, fixes, of_vehicle=type(record) not in self.of_payload)

    @abstractmethod
    def _state(self, record: Any, received: Stamp) -> ReportedState | None:
        """Return the vehicle's state by a record of the table, None if it has none."""


def state_of(record: Any, received: Stamp, **apart: float) -> ReportedState:
    """Take the numbers that a record has under the names of the state; apart: what came in sentences of its own.

    An altitude of zero is NaN: units report it where they measured nothing.
    """
    stated = {name: apart.get(name, getattr(record, name, NAN)) for name in ReportedState._fields[1:]}
    stated["altitude_m"] = record.altitude_m if record.altitude_m > 0.0 else NAN
    return ReportedState(received, **stated)
