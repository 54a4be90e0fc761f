"""Check the self-check of ports: devices present, silent or wrong; a port in use is left alone."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from auv_mcm.records import NAN
from auv_mcm.settings.config import parse_config
from auv_mcm.shell.check.finding import Finding
from drivers.links.serial_port import open_serial
from drivers.navigation.nmea0183 import sentence
from drivers.port_check import port_findings
from drivers.sonar.ping_messages import encode
from sim_replay.fakes.navigation import NAVIGATION_UNITS
from sim_replay.fakes.port import FakePort
from tests.drivers.sonar.sonar_frames import profile
from tests.make.records import nav_of

LISTEN_S = 0.6
SAMPLE = nav_of(1.0, heading_rad=0.3, depth_m=2.0, speed_mps=NAN)


def findings(ports: str) -> list[Finding]:
    """Check ports; that there is no sonar among them, or no beam stated, is for other tests."""
    found = port_findings(parse_config(f"ports: [{ports}]", "c.yaml"), LISTEN_S)
    return [each for each in found if each.name not in ("sonar", "beam width")]


def serial(path: Path, device: str, more: str = "") -> str:
    return f"{{name: one, link: 'serial://{path}?baud=115200', device: {device}{more}}}"


@asynccontextmanager
async def spoken(path: Path, says: Callable[[], list[bytes]], every_s: float = 0.05) -> AsyncIterator[FakePort]:
    """Fake a device that repeats one message."""
    port = FakePort(path, 115200)
    port.plug()

    async def speak() -> None:
        while True:
            for message in says():
                await port.send(message)
            await asyncio.sleep(every_s)

    speaking = asyncio.ensure_future(speak())
    try:
        yield port
    finally:
        speaking.cancel()
        await asyncio.wait({speaking})
        port.unplug()


def of_unit(name: str) -> Callable[[], list[bytes]]:
    unit = NAVIGATION_UNITS[name]()
    n_reported = 0

    def says() -> list[bytes]:
        nonlocal n_reported
        n_reported += 1
        return [
            message
            for message in unit.measured(SAMPLE, 1_700_000_000.0 + 0.1 * n_reported)
            if isinstance(message, bytes)
        ]

    return says


def checked(path: Path, says: Callable[[], list[bytes]], ports: str) -> Finding:
    async def run() -> Finding:
        async with spoken(path, says):
            return (await asyncio.to_thread(findings, ports))[0]

    return asyncio.run(run())


def test_a_serial_port_that_does_not_exist_is_a_failure_that_names_it(tmp_path: Path) -> None:
    (found,) = findings(serial(tmp_path / "ttyUSB9", "nmea0183"))
    assert found.verdict == "FAILED"
    assert found.name == "port one"
    assert f"{tmp_path}/ttyUSB9: no such device" in found.detail
    assert "ls -l /dev/serial/by-id" in found.detail


def test_a_unit_that_speaks_as_configured_is_sound(tmp_path: Path) -> None:
    found = checked(tmp_path / "tty", of_unit("nmea0183"), serial(tmp_path / "tty", "nmea0183"))
    assert found.verdict == "ok"
    assert "messages of 'nmea0183'" in found.detail


def test_a_unit_at_the_wrong_port_is_identified_by_what_it_sends(tmp_path: Path) -> None:
    found = checked(tmp_path / "tty", of_unit("pd6"), serial(tmp_path / "tty", "nmea0183"))
    assert found.verdict == "FAILED"
    assert "they are messages of 'pd6'. Set device: pd6, or change the cables" in found.detail


def test_noise_as_of_a_wrong_rate_is_a_failure_that_names_the_rate(tmp_path: Path) -> None:
    found = checked(tmp_path / "tty", lambda: [b"\x00\xf8\x80\xfe"], serial(tmp_path / "tty", "nmea0183"))
    assert found.verdict == "FAILED"
    assert "115200 baud" in found.detail


def test_a_silent_unit_is_a_failure_and_a_sonar_that_waits_for_commands_a_warning(tmp_path: Path) -> None:
    unit = checked(tmp_path / "tty", list, serial(tmp_path / "tty", "nmea0183"))
    assert (unit.verdict, "nothing was received" in unit.detail) == ("FAILED", True)
    heard: list[bytes] = []

    async def run() -> Finding:
        async with spoken(tmp_path / "tty", list) as port:
            port.on_bytes = heard.append
            return (
                await asyncio.to_thread(findings, serial(tmp_path / "tty", "ping_protocol", ", sonar: {range_m: 30}"))
            )[0]

    sonar = asyncio.run(run())
    assert (sonar.verdict, "may wait for the commands" in sonar.detail) == ("warning", True)
    assert heard == [], "a check sends nothing"


def test_a_serial_port_that_a_service_has_open_is_left_alone_with_every_byte(tmp_path: Path) -> None:
    async def run() -> tuple[Finding, bytes, bytes]:
        said = b""

        def says() -> list[bytes]:
            nonlocal said
            said += b"$TEST\r\n"
            return [b"$TEST\r\n"]

        port = FakePort(tmp_path / "tty", 115200)
        port.plug()
        service = await open_serial(str(tmp_path / "tty"), 115200, Counter())
        checking = asyncio.ensure_future(asyncio.to_thread(findings, serial(tmp_path / "tty", "nmea0183")))
        while not checking.done():
            for message in says():
                await port.send(message)
            await asyncio.sleep(0.02)
        await asyncio.sleep(0.05)
        heard = b"".join(service.read())
        service.close()
        port.unplug()
        return checking.result()[0], said, heard

    found, said, heard = asyncio.run(run())
    assert found.verdict == "warning"
    assert "in use by another program" in found.detail
    assert heard == said


def test_a_tcp_device_that_a_service_is_connected_to_is_left_alone() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port)), server.accept()[0]:
            (found,) = findings(f"{{name: one, link: 'tcp://127.0.0.1:{port}', device: jsf}}")
            server.settimeout(0.05)
            with pytest.raises(TimeoutError):
                server.accept()
    assert found.verdict == "warning"
    assert "is connected to it" in found.detail


def test_a_tcp_device_that_refuses_and_a_can_interface_that_is_not_there_are_failures() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    refused, bus = findings(
        f"{{name: one, link: 'tcp://127.0.0.1:{port}', device: nmea0183}}, {{name: two, link: 'socketcan://nocan0', "
        f"device: nmea2000}}"
    )
    assert (refused.verdict, bus.verdict) == ("FAILED", "FAILED")
    assert "refused" in refused.detail
    assert "socketcan://nocan0" in bus.detail


def test_a_silent_bus_is_a_failure_that_names_the_bit_rate() -> None:
    (found,) = findings("{name: one, link: 'can-virtual://silent', device: nmea2000}")
    assert found.verdict == "FAILED"
    assert "its bit rate, its wires and its termination" in found.detail


def test_an_address_that_is_none_is_a_failure_that_names_it() -> None:
    (found,) = findings("{name: one, link: 'tcp://192.168..2:5000', device: nmea0183}")
    assert found.verdict == "FAILED"
    assert "host '192.168..2' is unknown" in found.detail


def test_a_port_without_permission_names_the_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "tty"
    path.touch()
    opened = os.open

    def refused(name: str | bytes | os.PathLike[str], *rest: int, **more: int) -> int:
        if name == str(path):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))  # root, as in a test, is never refused
        return opened(name, *rest, **more)

    monkeypatch.setattr(os, "open", refused)
    (found,) = findings(serial(path, "nmea0183"))
    assert found.verdict == "FAILED"
    assert "permission denied. Add the user" in found.detail


# --- pings and quantities ---


@asynccontextmanager
async def served(says: Callable[[int], bytes], every_s: float = 0.02) -> AsyncIterator[int]:
    """Serve a device over TCP, which sends from the moment on that it is connected to; gives the port."""

    async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        number = 0
        try:
            while True:
                writer.write(says(number))
                await writer.drain()
                number += 1
                await asyncio.sleep(every_s)
        except (ConnectionError, asyncio.CancelledError):
            writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()


def of_tcp(device: str, says: Callable[[int], bytes], more: str = "") -> list[Finding]:
    async def run() -> list[Finding]:
        async with served(says) as port:
            text = f"{{name: one, link: 'tcp://127.0.0.1:{port}', device: {device}}}{more}"
            return await asyncio.to_thread(findings, text)

    return asyncio.run(run())


def profiles(number: int) -> bytes:
    return b"".join(
        encode(profile(ping_number=number, timestamp_ms=20 * number, channel_number=channel)) for channel in (0, 1)
    )


def test_a_sonar_that_sends_at_once_is_counted_in_pings(capfd: pytest.CaptureFixture[str]) -> None:
    (found,) = of_tcp("ping_protocol", profiles)
    assert found.verdict == "ok"
    assert "pings of port and starboard, 4 samples a side to 50.0 m, " in found.detail
    assert " a second" in found.detail
    assert capfd.readouterr().err == ""


def test_what_a_sonar_reports_of_its_sides_is_a_warning() -> None:
    def turned(number: int) -> bytes:
        return encode(profile(ping_number=number, timestamp_ms=100 * number, transducer_heading_deg=90.0))

    async def run() -> list[Finding]:
        async with served(turned, every_s=0.0) as port:
            text = f"{{name: one, link: 'tcp://127.0.0.1:{port}', device: ping_protocol}}"
            return await asyncio.to_thread(findings, text)

    (found,) = asyncio.run(run())
    assert found.verdict in ("ok", "warning")  # by the number of pings that came before enough were heard
    assert "starboard" in found.detail


def test_pings_that_cannot_be_used_are_a_warning_that_says_why() -> None:
    (found,) = of_tcp("ping_protocol", lambda number: encode(profile(length_mm=0)))
    assert found.verdict == "warning"
    assert "but no ping (ping_protocol.refused.range" in found.detail


def gga(number: int) -> bytes:
    return sentence(f"GPGGA,0000{number % 60:02d}.00,4300.0000,N,00500.0000,E,4,10,0.8,1.0,M,48.0,M,,")


def hdt(number: int) -> bytes:
    return sentence("GPHDT,17.5,T")


def test_quantities_of_a_unit_are_counted() -> None:
    (found,) = of_tcp("nmea0183", lambda number: gga(number) + hdt(number))
    assert found.verdict == "ok"
    assert "position" in found.detail
    assert "heading" in found.detail


def test_units_that_speak_without_a_position_fail_the_check() -> None:
    found = of_tcp("nmea0183", hdt)
    assert [finding.verdict for finding in found] == ["ok", "FAILED"]
    assert found[1].name == "position"
    assert "no unit that was heard (one) gave a position" in found[1].detail


@pytest.mark.parametrize(
    ("words", "is_asked"), [("{}", True), ("{beam_width_deg: 0.5}", False), ("{kind: sas}", False)]
)
def test_a_person_is_asked_for_a_beam_that_is_not_stated(words: str, is_asked: bool, tmp_path: Path) -> None:
    ports = f"{{name: sonar, link: 'serial://{tmp_path}/no?baud=115200', device: ping_protocol}}"
    config = parse_config(f"{{sonar: {words}, ports: [{ports}]}}", "c.yaml")
    asked = [each for each in port_findings(config, LISTEN_S) if each.name == "beam width"]
    assert [each.verdict for each in asked] == ["warning"] * is_asked
    assert all("sonar.beam_width_deg is empty" in each.detail for each in asked)


@pytest.mark.parametrize(("arm", "doubted"), [("[40, 0, -30]", ["sonar", "port ins"]), ("[0.4, 0, -0.3]", [])])
def test_a_lever_arm_in_centimetres_is_doubted(arm: str, doubted: list[str], tmp_path: Path) -> None:
    port = f"{{name: ins, link: 'serial://{tmp_path}/no?baud=115200', device: nmea0183}}"
    mounted = port.replace("}", f", navigation: {{lever_arm_m: {arm}}}}}")
    config = parse_config(f"{{sonar: {{lever_arm_m: {arm}}}, ports: [{mounted}]}}", "c.yaml")
    found = [each for each in port_findings(config, LISTEN_S) if "is it in metres" in each.detail]
    assert [each.name for each in found] == doubted
    assert all(each.verdict == "warning" for each in found)


def test_nobody_is_asked_for_the_beam_of_no_sonar(tmp_path: Path) -> None:
    ports = f"{{name: one, link: 'serial://{tmp_path}/no?baud=115200', device: nmea0183}}"
    found = port_findings(parse_config(f"ports: [{ports}]", "c.yaml"), LISTEN_S)
    assert "beam width" not in [each.name for each in found]
