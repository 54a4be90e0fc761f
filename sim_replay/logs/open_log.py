"""Open recorded logs; the format goes by a file's content, never by its name.

`FORMATS` has a row for each; other packages add rows, see `log_reader`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import structs

from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.safe_files import open_regular
from auv_mcm.settings.config import Config, SonarConfig
from auv_mcm.settings.port_settings import NavUnitSettings, PortConfig, SonarName, SonarPortConfig
from sim_replay.logs.foreign_formats import foreign_image, name_foreign
from sim_replay.logs.log_reader import CERTAIN, ExchangedSides, Log, LogFormat, added_formats

if TYPE_CHECKING:
    from sim_replay.logs.image_sidecar import Sidecar

CHUNK_BYTES: Final = 1 << 18  # bytes per read: bounds memory

_XTF_FIRST: Final = b"\x7b"
_JSON_FIRST: Final = re.compile(rb'\{\s*["}]')  # text that begins like an XTF file
_XTF_HEADER_BYTES: Final = 1024  # some of them always 0
_MCAP_FIRST: Final = b"\x89MCAP0\r\n"
_JSF_FIRST: Final = b"\x01\x16"
_SVLOG_FIRST: Final = b"BR"
_LOOK_BYTES: Final = 1 << 20  # in a damaged log the first whole message is looked for this far
_NO_LINK: Final = "tcp://127.0.0.1:1"  # ports need one; those of a log are never opened
# The sonar's own messages serve first; where they lack something, its motion sensor does, then sentences of others.
_HEADER_PRIORITY, _MOTION_PRIORITY, _NMEA_PRIORITY = 1, 2, 3
_UNWANTED_PRIORITY: Final = 99  # where the configuration takes navigation from other ports


def open_log(path: Path, config: Config, chunk_bytes: int = CHUNK_BYTES) -> Log:
    """Open a recorded log of any known format.

    It is a file of a sonar's recorder (XTF, JSF, svlog, Klein SDF, Lowrance, Humminbird with its folder), a recorded
    session (the session's folder, a recording in it, or one .mcap file of that), a sonar image with its sidecar, or a
    file of a format that another package reads.

    Ports are decoded as `config` states, a session's as they were recorded where it is silent. `chunk_bytes` sizes the
    read buffer of built-in formats and nothing else. Raises BadInputError for what is none of these or holds no side
    scan, UsageError where the subsystem must be chosen or several packages read the format.
    """
    log = find_format(path).opens(path, config, chunk_bytes)
    return ExchangedSides(log) if config.sonar.sides == "swapped" else log


def find_format(path: Path) -> LogFormat:
    """Recognise the format of a log by its content.

    Raises BadInputError for other files and unreadable ones, UsageError where several packages read the format.
    """
    from drivers.recording.session_layout import FILE_PATTERN
    from sim_replay.logs.session_parts import parts_of

    if path.is_dir():
        if parts_of(path):
            return SESSION
        if rows := [row for row in FORMATS if row.files and any(path.glob(row.files))]:
            return rows[0]
        raise BadInputError(
            f"{path} is a directory without a recorded session ({FILE_PATTERN}). Name a log inside it, "
            "or see and search all of them: 'auv-mcm view' and 'auv-mcm batch'."
        )
    if not path.exists():
        raise BadInputError(f"{path} does not exist. Check the path.")
    try:
        with open_regular(path) as file:
            head = file.read(_LOOK_BYTES)
    except OSError as error:
        raise BadInputError(f"{path} cannot be read: {error.strerror}. Check its permissions.") from error
    if not head:
        raise BadInputError(f"{path} is empty (0 bytes). The recorder wrote nothing, or a copy failed: fetch it again.")
    formats = FORMATS[:1] if _is_xtf(head) else FORMATS  # which are loaded, and look through all of the head
    strongest, found = max(((row.recognises(head), row) for row in formats), key=lambda claim: claim[0])
    if found.is_image and (foreign := foreign_image(head)) is not None:
        raise BadInputError(f"{path} is {foreign.title}. {foreign.remedy}.")
    if strongest:
        return found
    added, problems = added_formats(head)
    if len(added) > 1:
        names = " and ".join(one.name for one in added)
        raise UsageError(f"{path}: several packages read this format: {names}. Uninstall all but one of them.")
    if added:
        return added[0]
    hint = "".join(f"\nA plug-in that may know it does not work: {problem}." for problem in problems)
    if (named := name_foreign(head, path)) is not None:
        raise BadInputError(f"{path} is not a readable log: it is {named.title}. {named.remedy}.{hint}")
    raise BadInputError(
        f"{path} is not a readable log: it begins with 0x{head[:4].hex()}, and no message of a known format is "
        f"in its first {len(head)} bytes. Known are XTF (begins with 0x7b), EdgeTech JSF (0x0116), Ping Protocol svlog "
        "(0x4252), Klein SDF, Lowrance SL2 and SL3, Humminbird DAT and SON, sessions that 'auv-mcm run' recorded "
        "(.mcap or their folder), sonar images (TIFF, PNG, npy, "
        f"HDF5), and formats of plug-ins ('auv-mcm check' lists them). Export the log as one of these.{hint}"
    )


def describe_log(path: Path, config: Config) -> str:
    """Describe in a line a log's format and first ping. Raises BadInputError or UsageError as a replay would."""
    log = open_log(path, config)
    first_s = log.first_time_s()
    if not math.isfinite(first_s):
        raise BadInputError(f"{path} holds no ping. Check that a sonar was connected.")
    when = datetime.fromtimestamp(first_s, UTC).isoformat(" ", "seconds")
    return f"{find_format(path).title}, {sum(log.sizes_bytes.values()) / 1e6:.1f} MB, first ping {when}"


def logs_config(paths: list[Path]) -> Config | None:
    """Read the configuration that logs bring along, for use where none is given; None where they bring none.

    A session brings the one it was recorded with, an image the kind of sonar in its sidecar. Raises BadInputError.
    """
    for path in paths:
        if is_session(path):
            from sim_replay.logs.session_parts import JoinedSession
            from sim_replay.logs.session_reader import recorded_config

            return recorded_config(JoinedSession(path).sessions[0])
        if (sidecar := _sidecar_of(path)) is not None:
            return Config(sonar=SonarConfig(kind=sidecar.kind))
    return None


def kind_doubt(path: Path, config: Config) -> str:
    """Say why `sonar.kind` may not be that of a log, and what to do; empty where nothing speaks against it.

    Raises BadInputError or UsageError as a replay would.
    """
    if (sidecar := _sidecar_of(path)) is not None:
        from sim_replay.logs.image_log import kind_disagrees

        return "" if sidecar.kind == config.sonar.kind else kind_disagrees(path, sidecar, config.sonar).text
    if config.sonar.kind == "sas" and find_format(path).is_side_scan:
        return (
            "sonar.kind is sas, and logs of this format mostly hold side scan, whose resolution grows with range. Set "
            "sonar.kind: side_scan unless a processor wrote the log"
        )
    return ""


def _sidecar_of(path: Path) -> Sidecar | None:
    """Read the sidecar of an image; None for other logs, and for what cannot be read."""
    from sim_replay.logs.image_sidecar import read_sidecar

    try:
        is_image = find_format(path).is_image
    except (BadInputError, UsageError):
        return None
    return read_sidecar(path) if is_image else None


def is_session(path: Path) -> bool:
    """Check whether `path` is the folder or a file of a recorded session; False if it cannot be read."""
    try:
        return find_format(path) is SESSION
    except (BadInputError, UsageError):
        return False


def _is_xtf(head: bytes) -> int:
    if not head.startswith(_XTF_FIRST) or (_JSON_FIRST.match(head) and 0 not in head[:_XTF_HEADER_BYTES]):
        return 0
    return CERTAIN


def _begins(*firsts: bytes) -> Callable[[bytes], int]:
    return lambda head: CERTAIN * head.startswith(firsts)


def _jsf_messages(head: bytes) -> int:
    from drivers.framing import Framer
    from drivers.sonar.jsf import JsfGrammar

    return 2 * len(Framer(JsfGrammar()).feed(head)) or int(head.startswith(_JSF_FIRST))


def _svlog_messages(head: bytes) -> int:
    from drivers.framing import Framer
    from drivers.sonar.ping_protocol import PingGrammar

    return 2 * len(Framer(PingGrammar()).feed(head)) or int(head.startswith(_SVLOG_FIRST))


def _late(module: str) -> tuple[Callable[[bytes], int], Callable[[Path, Config, int], Log]]:
    """Make `recognise` and `open_file` of a reader's module, which is imported when one of them is called."""

    def recognises(head: bytes) -> int:
        return int(import_module(module).recognise(head))

    def opens(path: Path, config: Config, chunk_bytes: int) -> Log:
        log: Log = import_module(module).open_file(path, config, chunk_bytes)
        return log

    return recognises, opens


def _open_xtf(path: Path, config: Config, chunk_bytes: int) -> Log:
    from sim_replay.logs.xtf import XtfLog

    return XtfLog(path, config.sonar, epsg=config.navigation.epsg, chunk_bytes=chunk_bytes)


def _open_image(kind: str) -> Callable[[Path, Config, int], Log]:
    def opens(path: Path, config: Config, chunk_bytes: int) -> Log:
        from sim_replay.logs.image_log import ImageLog

        return ImageLog(path, kind, config.sonar)

    return opens


def _open_jsf(path: Path, config: Config, chunk_bytes: int) -> Log:
    from drivers.port_intake import PortIntake
    from sim_replay.logs.jsf_recording import (
        DOPPLER_PORT,
        MOTION_PORT,
        NMEA_PORT,
        NO_NAVIGATION,
        SONAR_PORT,
        JsfRecording,
    )
    from sim_replay.logs.log_order import PAUSE_S
    from sim_replay.logs.port_log import SonarLog

    recording = JsfRecording(
        path, config.sonar.subsystem, chunk_bytes, sound_speed_is_set=config.sonar.sound_speed_mps is not None
    )
    given = _only(config, "jsf")
    header = NavUnitSettings(priority=_HEADER_PRIORITY if given is None else _UNWANTED_PRIORITY)
    if given is not None and given.navigation is not None:
        header = given.navigation
    ports = (
        _sonar_port(SONAR_PORT, "jsf", given, header),
        _nmea_port(NMEA_PORT, _nmea_settings(config)),
        _nmea_port(MOTION_PORT, NavUnitSettings(priority=_MOTION_PRIORITY, delivers=("heading", "attitude"))),
        _nmea_port(
            DOPPLER_PORT,
            NavUnitSettings(priority=_MOTION_PRIORITY, delivers=("heading", "attitude", "altitude", "speed")),
        ),
    )
    used = structs.replace(config, ports=ports, sonar=structs.replace(config.sonar, subsystem=recording.subsystem))
    return SonarLog(recording, lambda: PortIntake(used), path, NO_NAVIGATION, PAUSE_S)


def _open_svlog(path: Path, config: Config, chunk_bytes: int) -> Log:
    from drivers.port_intake import PortIntake
    from sim_replay.logs.log_order import PAUSE_S
    from sim_replay.logs.port_log import SonarLog
    from sim_replay.logs.svlog_recording import MAVLINK_PORT, NMEA_PORT, NO_NAVIGATION, SONAR_PORT, SvlogRecording

    unit = structs.replace(_nmea_settings(config), use_unit_time=True)  # arrival is known to a ping interval only
    ports = (
        _sonar_port(SONAR_PORT, "ping_protocol", _only(config, "ping_protocol"), None),
        _nmea_port(NMEA_PORT, unit),
        _nmea_port(MAVLINK_PORT, NavUnitSettings(priority=_MOTION_PRIORITY, use_unit_time=True)),
    )
    used = structs.replace(config, ports=ports)
    return SonarLog(
        SvlogRecording(path, config.sonar.subsystem, chunk_bytes),
        lambda: PortIntake(used),
        path,
        NO_NAVIGATION,
        PAUSE_S,
    )


def _open_session(path: Path, config: Config, chunk_bytes: int) -> Log:
    from drivers.port_intake import PortIntake
    from sim_replay.logs.port_log import PortLog
    from sim_replay.logs.session_parts import JoinedSession
    from sim_replay.logs.session_reader import recorded_config

    session = JoinedSession(path)
    # A start may have had other links than the first; a configuration that is given serves all of them.
    first = recorded_config(session.sessions[0]) if not config.ports or len(session.sessions) > 1 else config
    if config.ports and config.ports != first.ports:
        return PortLog(session, lambda: PortIntake(config))
    ports = [first.ports, *(recorded_config(part).ports for part in session.sessions[1:])]
    return PortLog(session, lambda: PortIntake(structs.replace(config, ports=ports[session.part])))


def _only(config: Config, device: str) -> PortConfig | None:
    """Return the configured port with this device; None if there is none, or several."""
    found = [port for port in config.ports if port.device == device]
    return found[0] if len(found) == 1 else None


def _sonar_port(
    name: str, device: SonarName, given: PortConfig | None, navigation: NavUnitSettings | None
) -> PortConfig:
    """Return the sonar mounted as configured; a log holds both sides, so one-sided heads use the sonar's own side."""
    sides = SonarPortConfig()
    if given is not None and given.sonar is not None and given.sonar.sides in ("swapped", "by_number"):
        sides = SonarPortConfig(sides=given.sonar.sides)
    return PortConfig(name=name, link=_NO_LINK, device=device, sonar=sides, navigation=navigation)


def _nmea_settings(config: Config) -> NavUnitSettings:
    """Find the settings of the one configured NMEA 0183 unit, whose sentences are in the log."""
    given = _only(config, "nmea0183")
    settings = None if given is None else given.navigation
    if settings is None:
        return NavUnitSettings(priority=_NMEA_PRIORITY if given is None else 1)
    return structs.replace(settings, baud=None, gives_utc=False, pulse_link=None)


def _nmea_port(name: str, settings: NavUnitSettings) -> PortConfig:
    return PortConfig(name=name, link=_NO_LINK, device="nmea0183", navigation=settings)


SESSION: Final = LogFormat("session", "recorded session", _begins(_MCAP_FIRST), _open_session)
FORMATS: Final[tuple[LogFormat, ...]] = (
    LogFormat("xtf", "XTF", _is_xtf, _open_xtf, is_side_scan=True),
    SESSION,
    LogFormat(
        "tiff",
        "sonar image (TIFF)",
        _begins(b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),  # the last two: BigTIFF
        _open_image("tiff"),
        is_image=True,
    ),
    LogFormat("png", "sonar image (PNG)", _begins(b"\x89PNG"), _open_image("png"), is_image=True),
    LogFormat("npy", "sonar image (npy)", _begins(b"\x93NUMPY"), _open_image("npy"), is_image=True),
    LogFormat("hdf5", "sonar image (HDF5)", _begins(b"\x89HDF\r\n"), _open_image("hdf5"), is_image=True),
    LogFormat("svlog", "Ping Protocol (svlog)", _svlog_messages, _open_svlog, is_side_scan=True),
    LogFormat("jsf", "EdgeTech JSF", _jsf_messages, _open_jsf, is_side_scan=True),
    LogFormat("sdf", "Klein SDF", *_late("sim_replay.logs.klein_sdf"), is_side_scan=True),
    LogFormat("lowrance", "Lowrance or Simrad (SL2, SL3)", *_late("sim_replay.logs.lowrance"), is_side_scan=True),
    LogFormat(
        "humminbird",
        "Humminbird (DAT, SON)",
        *_late("sim_replay.logs.humminbird"),
        is_side_scan=True,
        files="[Bb]00[23].[Ss][Oo][Nn]",
    ),
)
"""The formats that are read, in the order of preference where two claim a file alike."""
