from __future__ import annotations

import asyncio
import socket

import pytest

from sim_replay.fakes.faults import FaultRates, Faults
from sim_replay.fakes.net import FakeTcpServer, FakeUdpDevice


async def until_clients(server: FakeTcpServer, n_clients: int) -> None:
    async with asyncio.timeout(10.0):
        while server.n_clients != n_clients:
            await asyncio.sleep(0.001)


async def test_every_client_of_a_server_hears_it_with_its_faults() -> None:
    rates = FaultRates(flip_byte=0.01, truncate=0.2)
    messages = [bytes([n]) * 100 for n in range(50)]
    faults = Faults(rates, 4)
    damaged = b"".join(data for message in messages for _, data in faults.passed(message))
    server = FakeTcpServer(Faults(rates, 4))
    await server.start()
    clients = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(2)]
    await until_clients(server, 2)
    for message in messages:
        await server.send(message)
    for reader, _ in clients:
        assert await asyncio.wait_for(reader.readexactly(len(damaged)), 10.0) == damaged
    await server.stop()
    for reader, writer in clients:
        assert await asyncio.wait_for(reader.read(), 10.0) == b""
        writer.close()


async def test_a_stopped_server_refuses_and_comes_back_on_its_port() -> None:
    server = FakeTcpServer()
    await server.start()
    port = server.port
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    await until_clients(server, 1)
    await server.stop(reset=True)
    with pytest.raises(ConnectionResetError):
        await asyncio.wait_for(reader.read(), 10.0)
    writer.close()
    with pytest.raises(ConnectionRefusedError):
        await asyncio.open_connection("127.0.0.1", port)
    await server.start()
    assert server.port == port
    _, writer = await asyncio.open_connection("127.0.0.1", port)
    await until_clients(server, 1)
    writer.close()
    await until_clients(server, 0)
    await server.stop()


async def test_a_stalled_server_stays_connected_and_sends_nothing() -> None:
    taken: list[bytes] = []
    server = FakeTcpServer(on_bytes=taken.append)
    await server.start()
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
    await until_clients(server, 1)
    server.stalled = True
    await server.send(b"lost")
    writer.write(b"lost, too")
    async with asyncio.timeout(10.0):
        while server.counters["tcp.cut"] != 13:
            await asyncio.sleep(0.001)
    server.stalled = False
    await server.send(b"heard")
    assert await asyncio.wait_for(reader.readexactly(5), 10.0) == b"heard"
    assert not taken
    writer.close()
    await server.stop()


async def test_datagrams_are_lost_doubled_and_overtaken_as_drawn() -> None:
    rates = FaultRates(lose=0.2, double=0.2, delay=0.2, delay_s=0.02)
    messages = [b"%03d" % n for n in range(100)]
    drawn = Faults(rates, 6)
    expected = sorted(data for message in messages for _, data in drawn.passed(message))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("127.0.0.1", 0))
        host.setblocking(False)
        device = FakeUdpDevice(Faults(rates, 6))
        for message in messages:
            device.send(message, *host.getsockname())
        came: list[bytes] = []
        async with asyncio.timeout(10.0):
            while len(came) < len(expected):
                came.append(await asyncio.get_running_loop().sock_recv(host, 100))
        assert sorted(came) == expected
        assert came != sorted(came)
        device.stalled = True
        device.send(b"lost", *host.getsockname())
        async with asyncio.timeout(10.0):
            while not device.counters["udp.cut"]:
                await asyncio.sleep(0.001)
        device.close()
