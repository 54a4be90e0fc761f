"""Start a recording of the ports that a configuration names."""

from __future__ import annotations

from pathlib import Path

from auv_mcm import __version__
from auv_mcm.clock import Clock, Stamp
from auv_mcm.settings.config import Config, config_yaml
from drivers.recording.session_layout import PortDescription, SessionDescription
from drivers.recording.session_recorder import SessionRecorder


def start_recording(folder: Path, config: Config, clock: Clock) -> SessionRecorder:
    """Begin a recording with its configuration and version. Raises UsageError, as `SessionRecorder`."""
    session = SessionDescription(
        version=__version__,
        started=Stamp(mono_ns=round(clock.monotonic_s() * 1e9), utc_ns=round(clock.utc_s() * 1e9)),
        config_yaml=config_yaml(config),
        ports=tuple(PortDescription(name=port.name, uri=port.link, device=port.device) for port in config.ports),
    )
    return SessionRecorder(folder, session)
