from __future__ import annotations

import termios

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clock import SystemClock
from auv_mcm.errors import UsageError
from drivers.links.open_link import byte_link, can_link
from drivers.links.uri import (
    BAUD_RATES,
    EXAMPLES,
    CanAddress,
    LinkAddress,
    SerialAddress,
    SlcanAddress,
    TcpAddress,
    UdpAddress,
    parse_link_uri,
)


@pytest.mark.parametrize(
    ("uri", "address"),
    [
        ("serial:///dev/ttyUSB0?baud=921600", SerialAddress("/dev/ttyUSB0", 921600)),
        (
            "serial:///dev/serial/by-id/usb-a%20b?baud=4800&silent_s=2.5",
            SerialAddress("/dev/serial/by-id/usb-a b", 4800, 2.5),
        ),
        ("slcan:///dev/ttyACM0?bitrate=250000", SlcanAddress("/dev/ttyACM0", 250000)),
        ("slcan:///dev/ttyS1?bitrate=1000000&baud=57600", SlcanAddress("/dev/ttyS1", 1000000, 57600)),
        ("socketcan://can0", CanAddress("socketcan", "can0")),
        ("can-virtual://bench?silent_s=60", CanAddress("virtual", "bench", 60.0)),
        ("udp://0.0.0.0:5000", UdpAddress("0.0.0.0", 5000)),
        ("udp://0.0.0.0:5000?peer=192.168.2.92", UdpAddress("0.0.0.0", 5000, "192.168.2.92")),
        ("udp://0.0.0.0:0?peer=192.168.2.92:51200", UdpAddress("0.0.0.0", 0, "192.168.2.92", 51200)),
        ("tcp://sonar.local:51200", TcpAddress("sonar.local", 51200)),
        ("tcp://[::1]:51200", TcpAddress("::1", 51200)),
    ],
)
def test_every_kind_of_link_is_understood(uri: str, address: LinkAddress) -> None:
    assert parse_link_uri(uri, "sonar.link") == address


@pytest.mark.parametrize("uri", EXAMPLES)
def test_the_examples_in_messages_are_right(uri: str) -> None:
    scheme, _, place = parse_link_uri(uri, "sonar.link").place.partition("://")
    assert uri.startswith(f"{scheme}://{place}")


@pytest.mark.parametrize(
    ("uri", "words"),
    [
        ("", "empty"),
        ("/dev/ttyUSB0", "the kind of link is missing; known: serial:///"),
        ("seriell:///dev/ttyUSB0", "unknown kind of link 'seriell'; known: serial:///"),
        ("serial:///dev/ttyUSB0", "baud is missing; add ?baud="),
        ("serial:///dev/ttyUSB0?baud=", "not a whole number"),
        ("serial:///dev/ttyUSB0?baud=9600.0", "not a whole number"),
        ("serial:///dev/ttyUSB0?baud=٩٦٠٠", "not a whole number"),
        ("serial:///dev/ttyUSB0?baud=96000", "baud=96000 is not a standard rate; near it are 38400, 57600, 115200"),
        ("serial:///dev/ttyUSB0?baud=9600&baud=4800", "given twice"),
        (
            "serial:///dev/ttyUSB0?baud=9600&parity=even",
            "'parity' is not an option of serial; known options: baud, silent_s",
        ),
        ("serial:///dev/ttyUSB0?921600", "not a URI"),
        ("serial://dev/ttyUSB0?baud=9600", "'dev' is read as a host; a path has three slashes"),
        ("serial:///?baud=9600", "device is missing"),
        ("serial:///dev/?baud=9600", "device is missing"),
        ("serial:///dev/tty%00?baud=9600", "device is missing"),
        ("serial:///dev/ttyUSB0 ?baud=9600", "spaces"),
        ("serial:///dev/ttyUSB0\n?baud=9600", "control characters"),
        ("serial:///dev/ttyUSB0?baud=9600#2", "'#'"),
        ("serial:///dev/ttyUSB0?baud=9600&silent_s=0", "silent_s='0' is not a time"),
        ("serial:///dev/ttyUSB0?baud=9600&silent_s=nan", "not a time"),
        ("serial:///dev/ttyUSB0?baud=9600&silent_s=1e9", "not a time"),
        ("slcan:///dev/ttyACM0", "bitrate is missing"),
        ("slcan:///dev/ttyACM0?bitrate=300000", "near it are 100000, 125000, 250000"),
        ("socketcan://", "not the name of a CAN interface"),
        ("socketcan:///can0", "'/can0' has no meaning here"),
        ("socketcan://can0?bitrate=250000", "'bitrate' is not an option of socketcan"),
        ("socketcan://can0-with-a-very-long-name", "not the name of a CAN interface"),
        ("udp://:5000", "':5000' is not an address; write e.g. 0.0.0.0:5000"),
        ("udp://0.0.0.0", "without a port"),
        ("udp://0.0.0.0?peer=10.0.0.1", "without a port"),
        ("udp://0.0.0.0:5000?peer=", "'' is not an address"),
        ("udp://0.0.0.0:99999", "not an address"),
        ("tcp://192.168.2.92", "port is missing"),
        ("tcp://me@192.168.2.92:51200", "not an address"),
        ("tcp://[::1:51200", "not a URI"),
        ("tcp://192.168.2.92:51200/stream", "'/stream' has no meaning here"),
    ],
)
def test_what_is_wrong_is_reported_with_its_place_and_a_way_out(uri: str, words: str) -> None:
    with pytest.raises(UsageError) as raised:
        parse_link_uri(uri, "sonar.link")
    assert words in str(raised.value)
    assert str(raised.value).startswith(f"sonar.link '{uri}': ")


def _with_insert(uri: str, inserted: str, at: int) -> str:
    return uri[:at] + inserted + uri[at:]


@given(st.text() | st.builds(_with_insert, st.sampled_from(EXAMPLES), st.text(max_size=8), st.integers(0, 40)))
def test_nothing_but_a_usage_error_comes_of_any_text(text: str) -> None:
    try:
        reports = parse_link_uri(text, "sonar.link").place
    except UsageError as error:
        reports = str(error)
    assert reports.startswith(("sonar.link ", *(uri.partition("//")[0] for uri in EXAMPLES)))


def test_every_rate_is_one_that_linux_knows() -> None:
    known = {int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()} - {0}
    assert set(BAUD_RATES) == known


def test_a_device_that_speaks_in_bytes_is_refused_a_bus_and_the_other_way_round() -> None:
    def ignore(*_: object) -> None:
        pass

    with pytest.raises(UsageError, match="is a CAN bus, but this device speaks in bytes"):
        byte_link(CanAddress("socketcan", "can0"), ignore, ignore, SystemClock())
    with pytest.raises(UsageError, match="is not a CAN bus"):
        can_link(TcpAddress("sonar", 1), ignore, ignore, SystemClock())
