"""Check pulses as the kernel stamps them, with a fake kernel: a bench has no source of pulses."""

from __future__ import annotations

import fcntl
import os
import struct
from collections import Counter
from pathlib import Path

import pytest

from auv_mcm.errors import HardwareError, UsageError
from drivers.links.open_link import byte_link, can_link
from drivers.links.pulse import KernelEdge, PulsePort, open_pulse, pack_edge, unpack_edge
from drivers.links.uri import parse_link_uri
from tests.drivers.links.link_watch import first_reason

NS = 1_000_000_000
UTC_S = 1_700_000_000


class Kernel:
    """Fake a clock and its newest pulse, each at a full second of UTC."""

    def __init__(self) -> None:
        self.now_s = 500.0
        self.utc_step_s = 0
        self.edge = KernelEdge(0, 0)
        self.error: OSError | None = None

    def monotonic_s(self) -> float:
        return self.now_s

    def utc_s(self) -> float:
        return UTC_S + self.now_s + self.utc_step_s

    def fetch(self) -> KernelEdge:
        if self.error is not None:
            raise self.error
        return self.edge

    def pulse(self, at_s: int) -> None:
        """Emit a pulse at the monotonic time at_s, which is a full second of UTC too."""
        self.edge = KernelEdge(self.edge.sequence + 1, (UTC_S + at_s + self.utc_step_s) * NS)


def port_of(kernel: Kernel, counters: Counter[str]) -> PulsePort:
    return PulsePort(kernel.fetch, lambda: None, "pps:///dev/pps0", kernel, counters)


def test_each_pulse_is_given_once_at_its_edge() -> None:
    kernel, counters = Kernel(), Counter[str]()
    port = port_of(kernel, counters)
    assert port.read() == []
    for at_s in (501, 502, 503):
        kernel.pulse(at_s)
        kernel.now_s = at_s + 0.0625
        (edge,) = port.read()
        assert abs((unpack_edge(edge) or 0) - at_s * NS) <= 1000
        kernel.now_s += 0.25
        assert port.read() == []
    assert counters == {"pps.edges": 3}
    assert not port.write(b"x")


def test_a_pulse_from_before_or_from_another_utc_is_left_out() -> None:
    kernel, counters = Kernel(), Counter[str]()
    kernel.pulse(498)
    port = port_of(kernel, counters)
    assert port.read() == []
    assert not counters, "one that was there before is not counted"
    kernel.pulse(500)
    kernel.utc_step_s, kernel.now_s = 3600, 500.1
    assert port.read() == []
    kernel.pulse(501)
    kernel.utc_step_s, kernel.now_s = 0, 501.1
    assert port.read() == []
    assert counters == {"pps.refused.age": 2}


def test_a_pulse_that_fails_is_lost_like_any_wire() -> None:
    kernel = Kernel()
    port = port_of(kernel, Counter())
    kernel.error = OSError(19, os.strerror(19))
    with pytest.raises(HardwareError, match=r"pps:///dev/pps0.*No such device"):
        port.read()


def test_edges_survive_packing_and_other_bytes_are_none() -> None:
    assert unpack_edge(pack_edge(5_000_000_000_123)) == 5_000_000_000_123
    assert unpack_edge(b"") is unpack_edge(b"1234567") is unpack_edge(bytes(9)) is None


async def test_the_kernels_answer_is_read_as_its_header_lays_it_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """linux/pps.h: both sequence numbers; seconds, ns and flags of both edges; mode; how long to wait."""
    answer = struct.pack("=II qiI qiI i4x qiI", 7, 8, UTC_S + 500, 250, 0, UTC_S + 499, 9, 0, 1, 0, 0, 0)
    answers = {0xC00870A4: answer}  # PPS_FETCH
    monkeypatch.setattr(fcntl, "ioctl", lambda descriptor, request, data: answers[request])
    (tmp_path / "pps0").touch()
    kernel = Kernel()
    kernel.now_s = 500.5
    port = await open_pulse(str(tmp_path / "pps0"), "pps0", kernel, Counter())
    (edge,) = port.read()
    port.close()
    assert abs((unpack_edge(edge) or 0) - (500 * NS + 250)) <= 1000


def test_what_is_no_source_of_pulses_is_reported(tmp_path: Path) -> None:
    assert "no such device. ls /sys/class/pps" in first_reason(f"pps://{tmp_path / 'pps0'}")
    (tmp_path / "file").write_bytes(b"")
    assert "not a source of pulses" in first_reason(f"pps://{tmp_path / 'file'}")


def test_a_pulse_is_no_bus() -> None:
    address = parse_link_uri("pps:///dev/pps0?silent_s=3", "ports[0].link")
    assert address.silent_s == 3.0
    assert byte_link(address, lambda data, stamp: None, lambda state, reason: None, Kernel()).place == "pps:///dev/pps0"
    with pytest.raises(UsageError, match="not a CAN bus"):
        can_link(address, lambda frame, stamp: None, lambda state, reason: None, Kernel())
