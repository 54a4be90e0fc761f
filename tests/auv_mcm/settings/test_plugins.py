"""Devices and log formats of other packages: found by name, loaded late, and refused clearly."""

from __future__ import annotations

import importlib.metadata
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from auv_mcm.clock import Stamp
from auv_mcm.commands import read_config
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import Notice, Ping
from auv_mcm.settings.config import Config, config_schema, parse_config
from auv_mcm.settings.plugins import find_plugins
from auv_mcm.shell.check.plugins import plugin_findings
from drivers.port_intake import PortIntake
from drivers.ports import read_ports
from sim_replay.logs.open_log import find_format
from sim_replay.logs.recorded import RecordedMission
from tests.plugin_packages import importable, install_example, write_package

PORT = "ports: [{{name: one, link: 'tcp://10.0.0.2:1', device: {device}{more}}}]"
SONAR, NAVIGATION, VEHICLE, LOGS = "auv_mcm.sonar", "auv_mcm.navigation", "auv_mcm.vehicle", "auv_mcm.logs"


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Path]:
    """Provide an empty folder on the module search path."""
    folder = tmp_path / "site"
    folder.mkdir()
    with importable(folder):
        yield folder


def intake_of(device: str, more: str = "") -> PortIntake:
    config = parse_config(PORT.format(device=device, more=more), "f.yaml")
    return PortIntake(config)


def test_built_in_devices_and_logs_cost_no_look_at_installed_packages(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fail(**_: object) -> None:
        raise AssertionError("the list of packages was read")

    monkeypatch.setattr(importlib.metadata, "entry_points", fail)
    for device, more in (("jsf", ""), ("nmea0183", ""), ("imc", ", imc: {}")):
        intake_of(device, more)
    read_config(None)
    (tmp_path / "log").write_bytes(b"\x7b\x00\x00\x00")
    assert find_format(tmp_path / "log").name == "xtf"


def test_a_plug_in_is_imported_only_when_it_is_named(site: Path) -> None:
    write_package(site, "noisy", {SONAR: {"noisy": "noisy:SONAR"}}, {"noisy": "raise RuntimeError('imported')"})
    intake_of("jsf")
    config = parse_config(PORT.format(device="noisy", more=""), "f.yaml")
    assert config.ports[0].device == "noisy"
    with pytest.raises(
        UsageError,
        match=r"noisy \(auv_mcm.sonar\) of noisy 1.2: noisy:SONAR cannot be imported \(RuntimeError: imported\)",
    ):
        PortIntake(config)


@pytest.mark.parametrize(
    ("group", "source", "more", "message"),
    [
        (
            SONAR,
            "",
            "",
            "AttributeError: module 'mine' has no attribute 'IT'). Update or uninstall mine 1.2, or report it",
        ),
        (SONAR, "import nowhere_to_be_found", "", "ModuleNotFoundError: No module named 'nowhere_to_be_found'"),
        (SONAR, "import sys\nsys.exit(3)", "", "mine:IT cannot be imported (SystemExit: 3)"),
        (SONAR, "IT = 3", "", "mine:IT is of type int, not drivers.sonar.sonars.SonarDevice"),
        (
            SONAR,
            "from drivers.sonar.sonars import SonarDevice\nIT = SonarDevice(lambda sonar: [], lambda settings: ())",
            "",
            "returned a list, which lacks counters, feed, finish, not a drivers.sonar.sonar_decoder.SonarDecoder",
        ),
        (
            SONAR,
            (
                "from drivers.sonar.sonars import SonarDevice\nIT = SonarDevice(lambda sonar: "
                "None, lambda settings: ['PING'])"
            ),
            ", sonar: {range_m: 30}",
            (
                'ports[0].sonar: mine (auv_mcm.sonar) of mine 1.2: failed with TypeError("memoryview: a bytes-like '
                "object is"
            ),
        ),
        (NAVIGATION, "IT = 3", "", "mine:IT is of type int, and does not make decoders"),
        (NAVIGATION, "def IT(source): raise KeyError(source)", "", "failed with KeyError('one')"),
        (
            NAVIGATION,
            "IT = str",
            "",
            "returned a str, which lacks counters, feed, finish, not a drivers.navigation.nav_decoder.NavDecoder",
        ),
        (VEHICLE, "IT = {}", "", "mine:IT is of type dict, not drivers.vehicle.vehicles.VehicleKind"),
        (
            VEHICLE,
            "from drivers.vehicle.vehicles import VehicleKind\nIT = VehicleKind(str, str, dict)",
            "",
            "not a class of msgspec.Struct",
        ),
        (
            VEHICLE,
            (
                "import msgspec as m\nfrom drivers.vehicle.vehicles import VehicleKind\nIT = VehicleKind(str, str, "
                "m.defstruct('S', []))"
            ),
            "",
            "its settings lack forbid_unknown_fields=True",
        ),
    ],
)
def test_a_plug_in_that_does_not_work_is_a_configuration_error(
    site: Path, group: str, source: str, more: str, message: str
) -> None:
    write_package(site, "mine", {group: {"mine": "mine:IT"}}, {"mine": source})
    with pytest.raises(UsageError, match=re.escape(message)):
        intake_of("mine", more)


def test_an_unknown_device_is_refused_with_those_of_other_packages(site: Path) -> None:
    install_example(site)
    expected = "port 'one': device 'acme_sonra' is unknown (did you mean acme_sonar? valid: ping_protocol, "
    with pytest.raises(UsageError, match=re.escape(expected)) as caught:
        parse_config(PORT.format(device="acme_sonra", more=""), "f.yaml")
    assert (
        "vehicle_can, acme_ins, acme_sonar, acme_vehicle). Correct it, or install the package that adds it - at "
        "`ports[0]`" in str(caught.value)
    )
    assert "acme_log" not in str(caught.value)


@pytest.mark.parametrize("other", [SONAR, NAVIGATION, VEHICLE])
def test_a_device_that_two_packages_add_is_refused(site: Path, other: str) -> None:
    write_package(site, "mine", {SONAR: {"mine": "mine:IT"}})
    write_package(site, "theirs", {other: {"mine": "theirs:IT"}})
    with pytest.raises(
        UsageError, match=r"device 'mine' is added more than once: .*\. Uninstall all but one of these packages"
    ) as caught:
        parse_config(PORT.format(device="mine", more=""), "f.yaml")
    assert "mine (auv_mcm.sonar) of mine 1.2" in str(caught.value)
    assert f"mine ({other}) of theirs 1.2" in str(caught.value)
    assert [finding.verdict for finding in plugin_findings()] == ["warning", "warning"]


@pytest.mark.parametrize("name", ["pulse", "My-Sonar", "a" * 33])
def test_a_name_that_no_port_can_have_is_refused(site: Path, name: str) -> None:
    write_package(site, "mine", {SONAR: {name: "mine:IT"}})
    with pytest.raises(UsageError, match=f"'{name}' is not a valid name. Use a small letter"):
        parse_config(PORT.format(device=name, more=""), "f.yaml")


def test_a_built_in_name_stays_built_in(site: Path) -> None:
    write_package(site, "mine", {SONAR: {"jsf": "mine:IT"}})
    assert intake_of("jsf").counters["jsf.messages"] == 0
    (finding,) = plugin_findings()
    assert finding.verdict == "warning"
    assert "'jsf' is a built-in device, which is used instead. Give the plug-in another name" in finding.detail


@pytest.mark.parametrize(
    ("device", "more", "message"),
    [
        (
            "acme_vehicle",
            ", options: {statoin: 2}",
            "ports[0].options: Object contains unknown field `statoin` (did you mean `station`?)",
        ),
        ("acme_vehicle", ", options: {station: 100}", "ports[0].options: Expected `int` <= 99 - at `station`"),
        (
            "acme_sonar",
            ", options: {station: 1}",
            "a section 'options' is for a vehicle's dialect that another package adds",
        ),
        (
            "imc",
            ", options: {own_plan: true}",
            "a section 'options' is for a vehicle's dialect that another package adds, and 'imc' is not",
        ),
        ("acme_vehicle", ", sonar: {range_m: 3}", "'acme_vehicle' is not a sonar"),
        (
            "acme_sonar",
            ", sonar: {range_m: 201}",
            "ports[0].sonar: acme_sonar: a range of 201 m cannot be set. Give 1 to 200 m.",
        ),
    ],
)
def test_settings_that_a_plug_in_does_not_have_are_refused_by_key(
    site: Path, device: str, more: str, message: str
) -> None:
    install_example(site)
    with pytest.raises(UsageError, match=re.escape(message)):
        read_ports(parse_config(PORT.format(device=device, more=more), "f.yaml"))


def test_commands_need_a_vehicle_built_in_or_not(site: Path) -> None:
    install_example(site)
    command = "vehicle: {command: true, fence_deg: [[42, 5], [42, 6], [43, 6]]}\n"
    assert parse_config(command + PORT.format(device="acme_vehicle", more=""), "f.yaml").vehicle.command
    with pytest.raises(UsageError, match="no port has a vehicle's device"):
        parse_config(command + PORT.format(device="acme_sonar", more=""), "f.yaml")


def test_the_schema_names_the_built_in_devices_and_allows_others() -> None:
    assert '"vehicle_can"' in config_schema()
    assert Config().ports == ()


DRIVER = """
import math, sys
from collections import Counter
import numpy as np
from auv_mcm.records import EchoTrace, NavSample
from drivers.navigation.nav_decoder import NavFix
from drivers.sonar.sonar_decoder import SonarFrame
from drivers.sonar.sonars import SonarDevice
class Decoder:
    counters = {counters}
    def feed(self, data, stamp):
        side = EchoTrace(samples=np.arange(9.0), first_range_m=0.05, spacing_m=0.1)
        frame = SonarFrame(number=1, port=side, starboard=side, transfer=None, received=stamp, n_bytes=9)
        fix = NavFix(source="one", received=stamp, latitude_deg=43.0, longitude_deg=5.0)
        return {given}
    def finish(self):
        return []
IT = {made}
"""
MADE = {SONAR: "SonarDevice(lambda sonar: Decoder(), lambda settings: ())", NAVIGATION: "lambda source: Decoder()"}


def driven(site: Path, group: str, given: str, counters: str = "Counter()") -> PortIntake:
    text = DRIVER.format(given=given, counters=counters, made=MADE[group])
    write_package(site, "mine", {group: {"mine": "mine:IT"}}, {"mine": text})
    return intake_of("mine")


@pytest.mark.parametrize(
    ("group", "given", "why"),
    [
        (
            SONAR,
            "[replace(frame, altitude_m=None)]",
            "SonarFrame.altitude_m is a NoneType None, not a number; NaN where",
        ),
        (SONAR, "[replace(frame, number=None)]", "SonarFrame.number is a NoneType None, not a whole number"),
        (
            SONAR,
            "[replace(frame, port=replace(side, samples=[1, 2]))]",
            "SonarFrame.port.samples is a list [1, 2], not a plain numpy array (n,) of real numbers",
        ),
        (
            SONAR,
            "[replace(frame, port=replace(side, samples=np.zeros((2, 9))))]",
            "SonarFrame.port.samples is a ndarray (2, 9) of float64, not a plain numpy array (n,)",
        ),
        (SONAR, "[replace(frame, transfer='log')]", "SonarFrame.transfer is a str 'log', not one of 'amplitude', "),
        (SONAR, "[fix]", "a NavFix was given, not a SonarFrame, SonarReply or Notice"),
        (SONAR, "sys.exit(3)", "it called sys.exit(3)"),
        (NAVIGATION, "[NavSample(time_s=1.0, latitude_deg=43.0)]", "a NavSample was given, not a NavFix"),
        (NAVIGATION, "[{'latitude_deg': 43.0}]", "a dict was given, not a NavFix"),
        (NAVIGATION, "[replace(fix, latitude_deg=None)]", "NavFix.latitude_deg is a NoneType None, not a number"),
        (NAVIGATION, "[replace(fix, received=None)]", "NavFix.received is a NoneType None, not a Stamp"),
    ],
)
def test_what_a_driver_may_not_give_is_named_by_its_field_and_package(
    site: Path, group: str, given: str, why: str
) -> None:
    intake = driven(site, group, given.replace("replace(", "__import__('msgspec').structs.replace("))
    (notice,) = intake.feed("one", b"x", Stamp(0, 0))
    assert isinstance(notice, Notice)
    assert notice.code == "decoder_failed"
    assert why in notice.text
    assert (
        "lost. Update or uninstall mine 1.2, or report it to its makers with the log and the recording." in notice.text
    )
    assert intake.counters["port.one.decoder.failed"] == 1


@pytest.mark.parametrize("counters", ["{'mine.messages': np.int64(2), 3: 1, 'mine.share': None}", "None"])
def test_counters_of_a_driver_can_be_added_and_written_whatever_they_are(site: Path, counters: str) -> None:
    intake = driven(site, NAVIGATION, "[fix]", counters)
    intake.feed("one", b"x", Stamp(0, 0))
    counted = json.loads(json.dumps(intake.counters))
    expected = {} if counters == "None" else {"port.one.mine.messages": 2, "port.one.3": 1}
    assert {name: n for name, n in counted.items() if name.startswith("port.")} == expected


def test_a_decoder_that_cannot_be_made_again_goes_on(site: Path) -> None:
    made = "made.append(1) or (Decoder() if len(made) == 1 else 1 / 0)"
    given = "[frame] if data == b'y' else 1 / 0"
    text = DRIVER.format(given=given, counters="Counter()", made=f"SonarDevice(lambda sonar: {made}, lambda s: ())")
    write_package(site, "mine", {SONAR: {"mine": "mine:IT"}}, {"mine": "made = []\n" + text})
    intake = intake_of("mine")
    assert [type(event) for data in (b"x", b"y") for event in intake.feed("one", data, Stamp(0, 0))] == [Notice, Ping]


def test_a_driver_may_use_one_buffer_for_all_pings(site: Path) -> None:
    given = "BUFFER.fill(data[0]) or [__import__('msgspec').structs.replace(frame, port=replaced(side))]"
    text = DRIVER.format(given=given, counters="Counter()", made=MADE[SONAR])
    replaced = "\nBUFFER = np.zeros(9)\ndef replaced(side):\n"
    replaced += "    return __import__('msgspec').structs.replace(side, samples=BUFFER)\n"
    write_package(site, "mine", {SONAR: {"mine": "mine:IT"}}, {"mine": text + replaced})
    intake = intake_of("mine")
    pings = [event for data in (b"\1", b"\2") for event in intake.feed("one", data, Stamp(0, 0))]
    assert [event.port.samples[0] for event in pings if isinstance(event, Ping) and event.port] == [1, 2]


# --- logs ---


def unreadable(site: Path) -> str:
    (site / "file").write_bytes(b"no log at all")
    with pytest.raises(BadInputError) as caught:
        find_format(site / "file")
    return str(caught.value)


def test_a_reader_that_does_not_work_is_named_where_no_format_is_recognised(site: Path) -> None:
    write_package(site, "mine", {LOGS: {"mine": "mine:IT"}}, {"mine": "IT = 3"})
    message = unreadable(site)
    assert "is not a readable log: it begins with 0x6e6f206c" in message
    assert (
        "A plug-in that may know it does not work: mine (auv_mcm.logs) of mine 1.2: mine:IT is of type int, not "
        "sim_replay" in message
    )
    assert "Update or uninstall mine 1.2" in message


READER = """
import numpy as np
from auv_mcm.records import NavSample, Notice, Ping
from sim_replay.logs.log_reader import LogReader
def events(path, file, config, counters):
    yield Ping(number=1, time_s=1.7e9, port=None, starboard=None)
    counters["mine.seen"] += np.int64(1)
    {then}
IT = LogReader("mine", lambda head: {recognises}, events)
"""


def test_a_reader_that_fails_at_recognising_is_named(site: Path) -> None:
    write_package(site, "mine", {LOGS: {"mine": "mine:IT"}}, {"mine": READER.format(recognises="1 / 0", then="")})
    assert "mine (auv_mcm.logs) of mine 1.2: failed with ZeroDivisionError('division by zero')" in unreadable(site)


def test_a_log_that_two_packages_read_is_refused(site: Path) -> None:
    for name in ("mine", "theirs"):
        write_package(site, name, {LOGS: {name: f"{name}:IT"}}, {name: READER.format(recognises="True", then="")})
    (site / "file").write_bytes(b"no log at all")
    with pytest.raises(
        UsageError, match=r"several packages read this format: mine .* and theirs .*\. Uninstall all but one"
    ):
        find_format(site / "file")


@pytest.mark.parametrize(
    ("then", "why"),
    [
        ("raise KeyError(3)", r"KeyError\(3\)"),
        ("raise SystemExit(3)", r"SystemExit\(3\)"),
        ("yield 3", "TypeError.*a int was given, not a Ping, NavSample or Notice"),
        (
            "yield NavSample(time_s=1.0, latitude_deg=None)",
            "TypeError.*NavSample.latitude_deg is a NoneType None, not a number; NaN where it is not known",
        ),
        ("yield Ping(number=2, time_s=None, port=None, starboard=None)", "TypeError.*Ping.time_s is a NoneType None"),
    ],
)
def test_a_reader_that_fails_within_a_log_ends_it_with_a_notice(site: Path, then: str, why: str) -> None:
    write_package(site, "mine", {LOGS: {"mine": "mine:IT"}}, {"mine": READER.format(recognises="True", then=then)})
    (site / "file").write_bytes(b"no log at all")
    mission = RecordedMission([site / "file"], Config())
    ping, notice = mission.events()
    assert isinstance(ping, Ping)
    assert isinstance(notice, Notice)
    assert (ping.number, notice.code) == (1, "log_reader_failed")
    assert re.search(rf"was read up to event 1 only: mine \(auv_mcm.logs\) of mine 1.2 failed with {why}", notice.text)
    assert json.dumps(mission.counters()) == '{"mine.seen": 1, "reader.failed": 1}'
    assert mission.fraction_done == 1.0


def test_a_log_without_a_ping_is_not_blamed_on_what_its_reader_remarks(site: Path) -> None:
    text = READER.replace("1.7e9", "float('nan')")
    then = "yield Notice(code='mine.old', text='written by version 2')"
    write_package(site, "mine", {LOGS: {"mine": "mine:IT"}}, {"mine": text.format(recognises="True", then=then)})
    (site / "file").write_bytes(b"no log at all")
    with pytest.raises(BadInputError, match=r"holds no ping\. Check that a sonar was connected"):
        RecordedMission([site / "file"], Config())


def test_the_check_lists_what_other_packages_add(site: Path) -> None:
    install_example(site)
    write_package(site, "broken", {LOGS: {"broken": "nowhere:IT"}})
    found = [(finding.name, finding.verdict, finding.detail) for finding in plugin_findings()]
    assert found[1:] == [
        ("plug-in broken", "warning", next(detail for name, _, detail in found if name == "plug-in broken")),
        ("plug-in acme_ins", "ok", "auv_mcm.navigation, acme-survey 1.2, acme_survey.navigation:NAVIGATION"),
        ("plug-in acme_sonar", "ok", "auv_mcm.sonar, acme-survey 1.2, acme_survey.sonar:SONAR"),
        ("plug-in acme_vehicle", "ok", "auv_mcm.vehicle, acme-survey 1.2, acme_survey.vehicle:VEHICLE"),
    ]
    assert found[0] == ("plug-in acme_log", "ok", "auv_mcm.logs, acme-survey 1.2, acme_survey.log:READER")
    assert "cannot be imported (ModuleNotFoundError: No module named 'nowhere')" in found[1][2]


def test_the_check_says_that_there_are_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.path", [])
    assert find_plugins() == ()
    (finding,) = plugin_findings()
    assert (finding.name, finding.verdict, finding.detail) == ("plug-ins", "ok", "none installed")
