"""Check that the printed interface is what the decoders do."""

from __future__ import annotations

import re
from pathlib import Path
from struct import Struct
from typing import get_args

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.cli import main
from auv_mcm.settings.config import Config
from auv_mcm.settings.port_settings import SONAR_NAMES, NavUnitName, NavUnitSettings, PortConfig, SonarPortConfig
from auv_mcm.settings.vehicle_settings import VEHICLE_NAMES
from drivers.describe import example_text, interface_text, struct_fields
from drivers.navigation.n2k_messages import MESSAGES
from drivers.navigation.sentences import SENTENCES
from drivers.ports import read_ports
from drivers.sonar.jsf_messages import DATA_HEADER, SideScanHeader
from drivers.sonar.ping_messages import FIXED_LAYOUTS, PROFILE_FIELDS, PROFILE_HEADER
from drivers.vehicle.can_messages import MESSAGES as CAN_MESSAGES
from drivers.vehicle.imc_codec import LAYOUTS
from drivers.vehicle.vehicles import VEHICLES
from tests.drivers.port_traffic import PORTS, config_of

CODES = {"i8": "b", "u8": "B", "i16": "h", "u16": "H", "i32": "i", "u32": "I", "f32": "f"}


@pytest.mark.parametrize(
    ("names", "layout"),
    [
        (PROFILE_FIELDS, PROFILE_HEADER),
        (SideScanHeader._fields, DATA_HEADER),
        *((kind._fields, layout) for kind, layout in FIXED_LAYOUTS.values()),
    ],
)
def test_every_field_stands_at_its_offset(names: tuple[str, ...], layout: Struct) -> None:
    data = bytes(range(layout.size % 256)) if layout.size < 128 else bytes(k % 120 for k in range(layout.size))
    for line, value, name in zip(struct_fields(names, layout), layout.unpack(data), names, strict=True):
        ((at, kind, reported),) = re.findall(r"^ *(\d+) (\d+ bytes|\w+) +(\w+)$", line)
        one = Struct(f"<{CODES[kind]}" if kind in CODES else f"{kind.split()[0]}s")
        assert reported == name
        assert str(one.unpack_from(data, int(at))[0]) == str(value)


@given(st.lists(st.sampled_from(["B", "2x", "H", "3s", "2i", "f"]), min_size=1, max_size=8))
def test_padding_moves_what_follows(codes: list[str]) -> None:
    layout = Struct("<" + "".join(codes))
    n_fields = sum({"2x": 0, "2i": 2}.get(code, 1) for code in codes)
    lines = struct_fields([f"f{k}" for k in range(n_fields)], layout)
    assert len(lines) == n_fields
    if lines and codes[-1] == "H":
        assert int(lines[-1].split()[0]) == layout.size - 2


def test_every_device_is_described_if_no_port_is_configured() -> None:
    text = interface_text(Config())
    for device in (*SONAR_NAMES, *get_args(NavUnitName), *VEHICLE_NAMES):
        assert f"\ndevice {device}: " in text
    assert all(f"PGN {pgn}, " in text for pgn in MESSAGES)
    assert all(key in text for key in SENTENCES)
    assert all(f"message {number}: " in text for number in LAYOUTS)
    assert all(f"message {message.number}, from the {message.sender}: " in text for message in CAN_MESSAGES)
    assert all(f"  {key}: " in text for key in ("$BFNVG", "$BPRMB", "$OSI", "$OMS", "#S", "#E"))
    assert not re.search(r"[ \t]$", text, re.MULTILINE)


def test_ports_are_printed_with_the_very_bytes_that_they_are_sent() -> None:
    config = config_of()
    text = interface_text(config)
    assert "port 'gnss': serial:///dev/ttyS0, 115200 baud" in text
    for command in read_ports(config)[0].commands:
        assert command.hex(" ") in text
    assert "device jsf" not in text


@pytest.mark.parametrize(
    ("vehicle", "lines"),
    [
        ("device: iver", ["1 heading_rad (57.3)", "2 depth_m (1.0)", "4 speed_mps (1.9)", "9 altitude_m (3.28)"]),
        ("device: iver, iver: {remote_helm_version: 4}", ["2 depth_m (3.3)"]),
        ("device: iver, iver: {contact_sentence: PABC}", ["  $PABC,C: ", "5 time_s (1.000)"]),
        ("device: bluefin", ["2 heading_rad (57.30)", "6-7 latitude_deg (0100.000000,N)", "21 length_m (1.00)"]),
        (
            "device: recon",
            ["2 number (1)", "13-18 belief in cylinder, sphere, truncated_cone, wedge, clutter, unknown"],
        ),
    ],
)
def test_a_vehicles_sentences_are_printed_as_they_are_on_its_wire(vehicle: str, lines: list[str]) -> None:
    text = interface_text(config_of(f"ports: [{{name: one, link: 'tcp://10.0.0.2:1', {vehicle}}}]"))
    assert [line for line in lines if line not in text] == []
    assert "report\n" not in text


def test_a_sentence_that_is_switched_off_is_not_printed() -> None:
    off = "ports: [{name: one, link: 'tcp://10.0.0.2:1', device: bluefin, bluefin: {contact_sentence: ''}}]"
    assert "ContactReport" not in interface_text(config_of(off))


def test_a_pulse_is_printed_with_its_bytes() -> None:
    text = interface_text(
        config_of(PORTS.replace("nmea0183", "nmea0183, navigation: {gives_utc: true, pulse_link: 'pps:///dev/pps0'}"))
    )
    assert "port 'gnss.pulse': pps:///dev/pps0\n  in:  pulse, for UTC\n  out: nothing" in text
    assert "Each edge is 8 bytes, big-endian" in text


def test_the_example_is_a_configuration() -> None:
    config = config_of(example_text())
    assert config.service.source == "ports"
    assert len(read_ports(config)) == len(config.ports) == 6


def test_every_key_of_a_port_is_explained() -> None:
    text = example_text()
    vehicles = [(vehicle.settings, f"{name}.") for name, vehicle in VEHICLES.items()]
    sections: list[tuple[type[msgspec.Struct], str]] = [
        (PortConfig, ""),
        (SonarPortConfig, "sonar."),
        (NavUnitSettings, "navigation."),
    ]
    for section, path in (*sections, *vehicles):
        for key in set(section.__struct_fields__) - {"sonar", "navigation", *VEHICLE_NAMES}:
            assert re.search(rf"^#   {path}{key}: .+; (default .+|required)", text, re.MULTILINE), key
    assert "#   navigation.roll_sign: one of -1, 1; default 1 - -1 for a unit" in text


def test_the_command_prints_both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--example"]) == 0
    assert capsys.readouterr().out == example_text()
    (tmp_path / "vehicle.yaml").write_text(PORTS)
    assert main(["run", "--interface", "--config", str(tmp_path / "vehicle.yaml")]) == 0
    assert capsys.readouterr().out == interface_text(config_of())


def test_ports_that_cannot_be_are_refused_by_every_command_that_reads_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "vehicle.yaml"
    path.write_text(PORTS.replace("baud=115200", "baud=115201"))
    assert main(["run", "--interface", "--config", str(path)]) == 2
    assert f"{path}: ports[1].link" in capsys.readouterr().err
