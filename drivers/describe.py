"""Describe every message that goes in or out of the ports, with its layout, from the decoders' own tables."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from struct import Struct, calcsize
from types import MappingProxyType, ModuleType
from typing import Any, Final, NamedTuple, get_args

from auv_mcm.settings.config import Config
from auv_mcm.settings.key_words import port_keys
from auv_mcm.settings.plugins import find_device
from auv_mcm.settings.port_settings import SONAR_NAMES, NavUnitName
from auv_mcm.settings.vehicle_settings import VEHICLE_NAMES, BluefinSettings, IverSettings, ReconSettings
from drivers.links import pulse
from drivers.links.uri import EXAMPLES
from drivers.navigation import dvl_pd6, dvl_water_linked, n2k_messages, nmea0183, sentences
from drivers.navigation.sentence_fields import Codec
from drivers.ports import PULSE, PortSettings, read_ports
from drivers.sonar import imagenex, jsf_messages, ping_messages
from drivers.vehicle import bluefin_sentences, can_messages, imc_codec
from drivers.vehicle.ascii_fields import CLASSES, CONTACT, CONTACT_FIELDS, Table
from drivers.vehicle.dialect import ContactReport
from drivers.vehicle.iver_sentences import table_of as iver_table
from drivers.vehicle.recon_sentences import table_of as recon_table
from drivers.vehicle.talkers import iver_talker as iver
from drivers.vehicle.talkers import recon_talker as recon
from drivers.vehicle.vehicles import VehicleSettings

_EXAMPLE: Final = """\
# Ports of a vehicle, for a configuration file. 'auv-mcm run --interface' prints what is spoken there.
service:
  source: ports

ports:
  # The sonar. It receives these settings at the start and whenever it comes back.
  - name: sonar
    link: tcp://192.168.2.92:51200
    device: ping_protocol
    sonar: {range_m: 50, n_samples: 1200}

  # The inertial unit, which comes first for all that it delivers.
  - name: ins
    link: serial:///dev/ttyUSB0?baud=115200
    device: pixse
    navigation: {priority: 0, pitch_sign: -1, latency_s: 0.02}

  - name: dvl
    link: serial:///dev/ttyUSB1?baud=115200
    device: pd6
    navigation: {delivers: [speed, altitude], heading_offset_deg: 45, lever_arm_m: [-0.4, 0.0, 0.2]}

  # A satellite receiver, believed at the surface only.
  - name: gnss
    link: serial:///dev/ttyUSB2?baud=9600
    device: nmea0183
    navigation: {priority: 2, delivers: [position, speed], surface_only: true, position_sigma_m: 2.5}

  # Everything on the vehicle's bus, as the last resort.
  - name: bus
    link: socketcan://can0
    device: nmea2000
    navigation: {priority: 3}

  # The vehicle's own controller, which receives contacts. With a section 'navigation' the position it reports is used
  # as well.
  - name: vehicle
    link: tcp://192.168.2.10:29500
    device: bluefin
    navigation: {priority: 4}
"""

_TYPES: Final = {
    "b": "i8",
    "B": "u8",
    "h": "i16",
    "H": "u16",
    "i": "i32",
    "I": "u32",
    "q": "i64",
    "Q": "u64",
    "f": "f32",
    "d": "f64",
}


def example_text() -> str:
    """Return ports for a configuration file, with the meaning of every key of a port."""
    return _EXAMPLE + "\n# All keys of a port:\n" + "".join(f"#   {line}\n" for line in port_keys())


class MessageLayout(NamedTuple):
    """Describe one kind of message. key: how it is identified on the wire. fields: a line each."""

    key: str
    record: Any
    fields: Sequence[str]


class _Language(NamedTuple):
    """Describe a device's protocol. about: the module whose docstring describes the framing."""

    about: ModuleType
    layouts: Callable[[], Iterable[MessageLayout]]


def interface_text(config: Config) -> str:
    """Describe the ports of a configuration with all their messages; without ports, every supported device.

    Raises UsageError for ports that cannot be.
    """
    ports = read_ports(config)
    if ports:
        lines = [line for port in ports for line in (*_port_lines(port), "")]
    else:
        lines = [
            "No ports are configured; these links and devices are available.",
            "",
            *(f"  {link}" for link in EXAMPLES),
            "",
        ]
    none = dict.fromkeys((*SONAR_NAMES, *get_args(NavUnitName), *VEHICLE_NAMES))
    for device, settings in ({port.device: port.vehicle for port in ports} or none).items():
        lines += [*_device_lines(device, settings), ""]
    return "\n".join(lines[:-1]) + "\n"


def struct_fields(names: Sequence[str], layout: Struct) -> list[str]:
    """Return a line per field of a structure: offset in bytes, type, name."""
    lines: list[str] = []
    at = 0
    order, codes = layout.format[0], re.findall(r"(\d*)([a-zA-Z])", layout.format[1:])
    for count, code in codes:
        n_repeats = 1 if code in "sx" else int(count or 1)
        unit = f"{count}{code}" if code in "sx" else code
        for _ in range(n_repeats):
            if code != "x":
                kind = f"{count} bytes" if code == "s" else _TYPES[code]
                lines.append(f"{at:4d} {kind:8} {names[len(lines)]}")
            at += calcsize(order + unit)
    assert len(lines) == len(names), "as many names as fields"
    return lines


def _port_lines(port: PortSettings) -> list[str]:
    baud = "" if port.baud is None else f", {port.baud} baud"
    lines = [f"port '{port.name}': {port.address.place}{baud}"]
    used = (
        "pings"
        if port.is_sonar
        else "the talk with the vehicle"
        if port.vehicle is not None
        else "UTC"
        if port.device == PULSE
        else "navigation"
    )
    used += " and navigation" if used != "navigation" and port.unit is not None else ""
    lines.append(f"  in:  {port.device}, for {used}")
    if port.vehicle is not None:
        return [
            *lines,
            (
                f"  out: {port.device}: contacts and health; commands only with vehicle.command and while the vehicle "
                "grants control"
            ),
        ]
    if not port.commands:
        return [*lines, "  out: nothing"]
    when = "when it opens or is heard again" if port.ask_every_s is None else f"every {port.ask_every_s:g} s"
    return [*lines, f"  out: {port.device}, {when}:", *(f"       {command.hex(' ')}" for command in port.commands)]


def _device_lines(device: str, settings: VehicleSettings | None) -> list[str]:
    if device not in _LANGUAGES:
        return [
            f"device {device}: of another package, {find_device(device)}, whose documentation describes its messages"
        ]
    language = _LANGUAGES[device]
    first, *rest = inspect.cleandoc(language.about.__doc__ or "").splitlines()
    lines = [f"device {device}: {first}", *(f"  {line}".rstrip() for line in rest)]
    if device in (*_TABLES, "nmea0183", "pixse"):
        lines.append(
            "  In brackets is how a 1 of the field's unit is written: 57.30 for 1 rad where the wire has degrees."
        )
    for layout in _table(device, settings) if device in _TABLES else language.layouts():
        doc = inspect.cleandoc(layout.record.__doc__ or "")
        own = "" if doc.startswith(f"{layout.record.__name__}(") else " ".join(doc.split())
        lines.append(f"  {layout.key}: {layout.record.__name__}" + (f" - {own}" if own else ""))
        lines += [f"      {field}" for field in layout.fields]
    return lines


def _ping_protocol() -> Iterable[MessageLayout]:
    for number, (kind, layout) in ping_messages.FIXED_LAYOUTS.items():
        yield MessageLayout(f"message {number}", kind, struct_fields(kind._fields, layout))
    profile = struct_fields(ping_messages.PROFILE_FIELDS, ping_messages.PROFILE_HEADER)
    results = f"{ping_messages.PROFILE_HEADER.size:4d} {'u16':8} pwr_results, n_results of them"
    yield MessageLayout(f"message {ping_messages.OS_MONO_PROFILE}", ping_messages.OsMonoProfile, [*profile, results])
    for number, record in (
        (ping_messages.NACK, ping_messages.Nack),
        (ping_messages.ASCII_TEXT, ping_messages.AsciiText),
        (ping_messages.JSON_WRAPPER, ping_messages.JsonWrapper),
    ):
        yield MessageLayout(f"message {number}", record, record._fields)


_JSF_HEADER: Final = (
    "sync",
    "version",
    "session",
    "message",
    "command",
    "subsystem",
    "channel",
    "sequence",
    "reserved",
    "n_bytes_behind",
)
_JSF_NUMBERS: Final = ("PING_ENABLE", "PING_GAIN", "PING_RANGE", "SYSTEM_TIME")


def _jsf() -> Iterable[MessageLayout]:
    yield MessageLayout("every message", jsf_messages.JsfMessage, struct_fields(_JSF_HEADER, jsf_messages.HEADER))
    fields = struct_fields(jsf_messages.SideScanHeader._fields, jsf_messages.DATA_HEADER)
    yield MessageLayout(f"message {jsf_messages.SIDE_SCAN}", jsf_messages.SideScanHeader, fields)
    numbers = [f"message {getattr(jsf_messages, name)}: {name.lower()}" for name in _JSF_NUMBERS]
    yield MessageLayout("sets or asks one number", jsf_messages.Command, numbers)


def _sportscan() -> Iterable[MessageLayout]:
    yield MessageLayout(
        f"command, {imagenex.COMMAND_BYTES} bytes", imagenex.SwitchCommand, imagenex.SwitchCommand._fields
    )
    yield MessageLayout(f"answer, {imagenex.RETURN_BYTES} bytes", imagenex.IgxReturn, imagenex.IgxReturn._fields)


def _nmea0183(is_of_burst: bool) -> Iterable[MessageLayout]:
    for key, kind in sentences.SENTENCES.items():
        if is_of_burst and not (key.startswith("PIXSE") or key == "HDT"):
            continue
        yield MessageLayout(
            f"${key}" if key.startswith(("P", "OHPR")) else f"$--{key}", kind.make, _sentence_fields(kind)
        )


def _sentence_fields(kind: sentences.Sentence[Any]) -> list[str]:
    """Return a line per field: its place behind the address, name, and what is written for the number 1."""
    at = 1 + kind.key.count(",")
    names = iter(kind.make._fields)  # type: ignore[attr-defined]  # every record is a named tuple
    named = [("not read" if codec is None else next(names), codec) for codec in kind.codecs]
    fields = []
    for name, codec in chain(*(CONTACT_FIELDS.items() if pair[1] is CONTACT else [pair] for pair in named)):
        n_fields = 1 if codec is None else codec.n_fields
        places = f"{at}" if n_fields == 1 else f"{at}-{at + n_fields - 1}"
        masses = f" in {', '.join(CLASSES)}" if name == "belief" else ""
        fields.append(f"{places:>5} {name}{masses}{'' if codec is None else _one(codec)}")
        at += n_fields
    return fields


def _one(codec: Codec) -> str:
    """Return how the number 1 is written, in brackets, which shows the wire's unit; empty for what is no number."""
    try:
        texts = codec.write(1)
    except (AttributeError, TypeError, ValueError):
        return ""
    return f" ({','.join(texts)})" if all(isinstance(text, str) for text in texts) else ""


def _pd6() -> Iterable[MessageLayout]:
    for record in get_args(dvl_pd6.Line):
        yield MessageLayout("line", record, record._fields)


def _water_linked() -> Iterable[MessageLayout]:
    for record in get_args(dvl_water_linked.Record):
        yield MessageLayout("message", record, record._fields)


def _nmea2000() -> Iterable[MessageLayout]:
    for pgn, message in n2k_messages.MESSAGES.items():
        fields = [
            f"bit {field.start_bit:3d} {'i' if field.signed else 'u'}{field.n_bits:<3d} x {field.resolution:<8g} {name}"
            # Every message is made by a named tuple.
            for field, name in zip(message.fields, message.make._fields, strict=True)  # type: ignore[attr-defined]
        ]
        yield MessageLayout(f"PGN {pgn}, {message.n_bytes} bytes", message.make, fields)


def _imc() -> Iterable[MessageLayout]:
    for number, layout in imc_codec.LAYOUTS.items():
        names = iter(layout.kind.__struct_fields__)
        fields = []
        for part in layout.parts:
            if isinstance(part, imc_codec.Numbers):
                fields += [f"{_TYPES[code]:8} {next(names)}" for code in part.layouts["<"].format[1:]]
            elif isinstance(part, str):
                fields.append(f"{part:8} {next(names)}")
            else:
                kind = "any message" if part.kind is None else part.kind.__name__
                many = "list of " if isinstance(part, imc_codec.Many) else ""
                fields.append(f"{'message':8} {next(names)}: {many}{kind}")
        yield MessageLayout(f"message {number}", layout.kind, fields)


_TABLES: Final[Mapping[str, tuple[Callable[[Any], Table], VehicleSettings, str]]] = MappingProxyType(
    {
        "bluefin": (bluefin_sentences.table_of, BluefinSettings(), "$"),
        "iver": (iver_table, IverSettings(), "$"),
        "recon": (recon_table, ReconSettings(), "#"),
    }
)
"""Of dialects of sentences, what makes their table of settings, these, and the first character."""


def _table(device: str, settings: VehicleSettings | None) -> Iterable[MessageLayout]:
    table_of, usual, start = _TABLES[device]
    for kind in table_of(settings or usual).kinds:
        record = ContactReport if CONTACT in kind.codecs else kind.make
        yield MessageLayout(f"{start}{kind.key}", record, _sentence_fields(kind))


def _vehicle_can() -> Iterable[MessageLayout]:
    for message in can_messages.MESSAGES:
        fields = []
        for part, first_byte, signal in message.placed:
            scale = "" if signal.scale is None else f"x {signal.scale:g} {signal.unit}".rstrip()
            kind = f"{'i' if signal.signed else 'u'}{8 * signal.n_bytes}"
            place = f"part {part} byte {first_byte}" if message.is_transfer else f"byte {first_byte}"
            fields.append(f"{place:14} {kind:4} {scale:10} {signal.name}: {signal.comment}")
        yield MessageLayout(f"message {message.number}, from the {message.sender}", message.make, fields)


_LANGUAGES: Final[Mapping[str, _Language]] = MappingProxyType(
    {
        "ping_protocol": _Language(ping_messages, _ping_protocol),
        "jsf": _Language(jsf_messages, _jsf),
        "sportscan": _Language(imagenex, _sportscan),
        "nmea0183": _Language(nmea0183, lambda: _nmea0183(False)),
        "pixse": _Language(nmea0183, lambda: _nmea0183(True)),
        "pd6": _Language(dvl_pd6, _pd6),
        "water_linked": _Language(dvl_water_linked, _water_linked),
        "nmea2000": _Language(n2k_messages, _nmea2000),
        "imc": _Language(imc_codec, _imc),
        "bluefin": _Language(bluefin_sentences, lambda: ()),
        "iver": _Language(iver, lambda: ()),
        "recon": _Language(recon, lambda: ()),
        "vehicle_can": _Language(can_messages, _vehicle_can),
        PULSE: _Language(pulse, lambda: ()),
    }
)
