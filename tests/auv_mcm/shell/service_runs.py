"""Run the service around a small pipeline, on sources made of given events, and read what it left."""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from auv_mcm.clock import Stamp
from auv_mcm.records import SourceEvent
from auv_mcm.settings.config import Config, ServiceConfig
from auv_mcm.shell.perception_chain import MakePipeline
from auv_mcm.shell.service import Service
from auv_mcm.source import EventSink, PortState, QuantityState, Record, SourceHealth, VehiclePilot
from tests.auv_mcm.shell import fake_pipelines as fake

RESULTS = {
    *("contacts.geojson", "contacts.csv", "contacts.kml", "contacts.jsonl"),
    *("coverage.geojson", "clearance.geojson", "waypoints.geojson", "summary.json", "snippets"),
    *("health.json", "health.jsonl"),
}
"""All files of a mission, and no other."""


class Events:
    """A source of given events; an exception among them is raised in its turn."""

    def __init__(
        self, events: Sequence[SourceEvent | Exception], *, lossless: bool = True, endless: bool = False
    ) -> None:
        self.lossless = lossless
        self._events = events
        self._endless = endless

    async def run(self, sink: EventSink) -> None:
        for event in self._events:
            if isinstance(event, Exception):
                raise event
            await self._give(event, sink)
        if self._endless:
            await asyncio.Event().wait()

    async def _give(self, event: SourceEvent, sink: EventSink) -> None:
        if self.lossless:
            await sink.put(event)
        else:
            sink.push(event)

    def counters(self) -> Counter[str]:
        return Counter({"source.events": len(self._events)})


class Ports(Events):
    """A live source of given events, which gives the rest when stopped. It hands a byte per event to the recorder."""

    def __init__(self, events: Sequence[SourceEvent | Exception], rest: Sequence[SourceEvent] = ()) -> None:
        super().__init__(events, lossless=False)
        self._rest = rest
        self._stopped = asyncio.Event()

    def record_with(self, record: Record) -> None:
        self._record = record

    def stop(self) -> None:
        self._stopped.set()

    def health(self) -> SourceHealth:
        return SourceHealth((PortState("one", "up", 1, 0, 0.0),), (QuantityState("position", "one", 0.0),))

    def faults(self) -> list[str]:
        return []

    vehicle: VehiclePilot | None = None

    async def serve_vehicle(self) -> None:
        raise AssertionError("there is no vehicle")

    async def run(self, sink: EventSink) -> None:
        await super().run(sink)
        await self._stopped.wait()
        for event in self._rest:
            sink.push(event)

    async def _give(self, event: SourceEvent, sink: EventSink) -> None:
        self._record("one", "in", Stamp(1, 2), b"x")
        await super()._give(event, sink)


def mission(n_pings: int) -> list[SourceEvent | Exception]:
    return [event for number in range(n_pings) for event in (fake.navigation(number), fake.ping(number))]


def serve(
    folder: Path,
    source: Events,
    make: MakePipeline = fake.Base,
    console: Callable[[str], None] = lambda line: None,
    queue_pings: int = 512,
) -> Path:
    config = Config(
        service=ServiceConfig(
            output_directory=str(folder), queue_pings=queue_pings, health_period_s=0.05, stop_within_s=60.0
        )
    )
    return asyncio.run(Service(config, source, console=console, make_pipeline=make).run())


def serve_ports(
    folder: Path, source: Ports, *, record: bool = True, console: Callable[[str], None] = lambda line: None
) -> Path:
    """Stops once the ninth ping's contact was announced."""

    async def run() -> Path:
        def stop_at_nine(line: str) -> None:
            console(line)
            if "C0009" in line:
                service.stop()

        config = Config(
            service=ServiceConfig(output_directory=str(folder), record=record, health_period_s=0.05, stop_within_s=60.0)
        )
        service = Service(config, source, console=stop_at_nine, make_pipeline=fake.Base)
        return await service.run()

    return asyncio.run(run())


def ids(results: Path) -> list[str]:
    return [
        feature["properties"]["id"] for feature in json.loads((results / "contacts.geojson").read_bytes())["features"]
    ]


def summary(results: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((results / "summary.json").read_bytes())
    return content


def journal(results: Path) -> list[str]:
    return [
        json.loads(line)["contact"]["properties"]["id"]
        for line in (results / "contacts.jsonl").read_text().splitlines()
    ]
