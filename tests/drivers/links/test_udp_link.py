from __future__ import annotations

import asyncio
import socket

from sim_replay.fakes.net import FakeUdpDevice
from tests.drivers.links.link_watch import first_reason, until, up, watched_bytes


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unused:
        unused.bind(("127.0.0.1", 0))
        return int(unused.getsockname()[1])


async def test_datagrams_arrive_whole_and_writes_go_to_the_peer() -> None:
    taken: list[bytes] = []
    device = FakeUdpDevice(on_bytes=taken.append)
    port = free_port()
    link, watch = watched_bytes(f"udp://127.0.0.1:{port}?peer=127.0.0.1:{device.port}")
    async with up(link):
        sent = [bytes([n]) * (n * 200) for n in range(1, 200)]
        for datagram in sent:
            device.send(datagram, "127.0.0.1", port)
        await until(lambda: len(watch.items) == len(sent))
        assert watch.items == sent
        assert link.write(b"set range")
        await until(lambda: taken == [b"set range"])
    assert link.counters["link.bytes_in"] == sum(map(len, sent))
    device.close()


async def test_a_peer_without_a_port_is_heard_from_any_of_its_ports_and_other_hosts_are_not() -> None:
    port = free_port()
    link, watch = watched_bytes(f"udp://0.0.0.0:{port}?peer=127.0.0.1")
    async with up(link):
        for host in ("127.0.0.2", "127.0.0.1", "127.0.0.1"):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                sender.bind((host, 0))
                sender.sendto(host.encode(), ("127.0.0.1", port))
        await until(lambda: len(watch.items) == 2)
    assert watch.items == [b"127.0.0.1"] * 2
    assert link.counters["udp.refused.foreign"] == 1


async def test_datagrams_of_others_are_refused_and_named_when_nothing_else_comes() -> None:
    peer, stranger = FakeUdpDevice(), FakeUdpDevice()
    port = free_port()
    link, watch = watched_bytes(f"udp://127.0.0.1:{port}?peer=127.0.0.1:{peer.port}&silent_s=0.1")
    async with up(link):
        stranger.send(b"not mine", "127.0.0.1", port)
        peer.send(b"mine", "127.0.0.1", port)
        await until(lambda: watch.items and link.counters["udp.refused.foreign"] == 1)
        assert watch.items == [b"mine"]
        while link.state != "silent":
            stranger.send(b"not mine", "127.0.0.1", port)
            await asyncio.sleep(0.01)
        assert f"Datagrams come from 127.0.0.1:{stranger.port}, which is not the peer" in watch.reason
    peer.close()
    stranger.close()


async def test_without_a_peer_anybody_is_heard_and_nothing_can_be_sent() -> None:
    device = FakeUdpDevice()
    port = free_port()
    link, watch = watched_bytes(f"udp://0.0.0.0:{port}")
    async with up(link):
        device.send(b"heard", "127.0.0.1", port)
        await until(lambda: watch.items == [b"heard"])
        assert not link.write(b"to whom?")
    assert link.counters["link.writes_refused"] == 1
    device.close()


async def test_a_datagram_too_long_to_send_is_refused() -> None:
    link, _ = watched_bytes("udp://127.0.0.1:0?peer=127.0.0.1:9")
    async with up(link):
        assert not link.write(bytes(70_000))
    assert link.counters["udp.send_failed"] == 1


def test_ports_and_addresses_that_cannot_be_used_are_reported() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        assert "in use by another program" in first_reason(f"udp://127.0.0.1:{port}")
    assert "not an address of this computer. Write 0.0.0.0" in first_reason("udp://192.0.2.1:5000")
