"""Open the configured source, and the recorder of its ports, by their registered names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from urllib.parse import parse_qsl, unquote, urlsplit

from auv_mcm.clock import Clock
from auv_mcm.errors import UsageError
from auv_mcm.settings.config import Config
from auv_mcm.shell.registry import RECORDER, SOURCES, load
from auv_mcm.source import Recorder, Source, SourceUri

OpenSource = Callable[[SourceUri, Config, Clock], Source]
StartRecording = Callable[[Path, Config, Clock], Recorder]


def parse_source_uri(text: str) -> SourceUri:
    """Parse `service.source`: `ports`, or scheme:path?option=value&... Raises UsageError."""
    known = "ports, " + ", ".join(f"{scheme}:" for scheme in sorted(SOURCES) if scheme != "ports")
    if not text:
        raise UsageError(
            "service.source is empty: name where pings come from, e.g. source: replay:///data/mission.xtf?speed=1"
        )
    if text == "ports":
        return SourceUri(text, text, "", {})
    try:
        parts = urlsplit(text)
        options = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
    except ValueError as error:
        raise UsageError(f"service.source '{text}' is not a URI: {error}") from error
    if parts.scheme not in SOURCES:
        raise UsageError(f"service.source '{text}': unknown scheme '{parts.scheme}'. Known: {known}")
    if parts.netloc:
        raise UsageError(
            f"service.source '{text}': '{parts.netloc}' is read as a host. A path has three slashes: {parts.scheme}:///path"
        )
    if len(dict(options)) < len(options):
        raise UsageError(f"service.source '{text}': an option is given twice")
    return SourceUri(text, parts.scheme, unquote(parts.path), dict(options))


def open_source(uri: SourceUri, config: Config, clock: Clock) -> Source:
    """Open the source that `uri` names. Raises UsageError, BadInputError or HardwareError."""
    opener: OpenSource = load(SOURCES[uri.scheme])
    return opener(uri, config, clock)


def start_recording(folder: Path, config: Config, clock: Clock) -> Recorder:
    """Start recording what live ports receive and send, in `folder`. Raises UsageError or OSError."""
    start: StartRecording = load(RECORDER)
    return start(folder, config, clock)
