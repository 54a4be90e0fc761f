"""Decode a Water Linked DVL, which sends text on its serial line and JSON over TCP."""

from __future__ import annotations

from collections import Counter

from auv_mcm.clock import Stamp
from drivers.framing import StampedFramer, StampedMessage
from drivers.navigation.dvl_water_linked import Record, TextGrammar, Velocity, fix_fields, parse
from drivers.navigation.dvl_water_linked_json import JsonReports
from drivers.navigation.nav_decoder import NavFix


class WaterLinkedUnit:
    """Decode one link's messages to fixes. Never raises, whatever the bytes.

    The first message, in text or in JSON, decides which of them the link speaks. `counters`: those of the framer
    (`water_linked.*`), `.malformed` (checksum right, fields impossible), `.ignored` (`wru` and other kinds),
    `.no_bottom_lock`.
    """

    def __init__(self, source: str) -> None:
        self._source = source
        self._framer = StampedFramer(TextGrammar())
        self._own: Counter[str] = Counter()
        self._json_counters: Counter[str] = Counter()
        self._reports: JsonReports | None = JsonReports(self._json_counters)
        self._is_json = False

    @property
    def counters(self) -> Counter[str]:
        return self._own + (self._json_counters if self._is_json else self._framer.counters)

    def feed(self, data: bytes, stamp: Stamp) -> list[NavFix]:
        """Return what a chunk completes, in order. stamp: when its last byte was read."""
        if self._reports is not None:
            records = self._reports.feed(data)
            self._is_json = self._is_json or bool(records)
            if self._is_json:
                return [self._fix(record, stamp, 0) for record in records]
        fixes = [fix for arrived in self._framer.feed(data, stamp) for fix in self._fixes(arrived)]
        if self._framer.counters["water_linked.messages"]:
            self._reports = None
        return fixes

    def finish(self) -> list[NavFix]:
        """Return what still waited at the end of a log or link."""
        if self._is_json:
            return []
        return [fix for arrived in self._framer.finish() for fix in self._fixes(arrived)]

    def _fixes(self, arrived: StampedMessage[str]) -> list[NavFix]:
        try:
            record = parse(arrived.message)
        except ValueError:
            self._own["water_linked.malformed"] += 1
            return []
        if record is None:
            self._own["water_linked.ignored"] += 1
            return []
        return [self._fix(record, arrived.received, arrived.n_bytes)]

    def _fix(self, record: Record, received: Stamp, n_bytes: int) -> NavFix:
        if isinstance(record, Velocity) and not record.good:
            self._own["water_linked.no_bottom_lock"] += 1
        return NavFix(source=self._source, received=received, n_bytes=n_bytes, **fix_fields(record))
