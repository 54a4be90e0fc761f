"""A vehicle made of imcpy, in a process of its own on loopback, takes what the driver says and is understood."""

from __future__ import annotations

import json
import math
import select
import socket
import subprocess
import sys
import time
from importlib.util import find_spec

import pytest

from auv_mcm.clock import Stamp
from auv_mcm.settings.vehicle_settings import ImcSettings
from drivers.vehicle.decoders.imc_followed import PLAN_ID
from drivers.vehicle.dialect import GoTo, Granted, PayloadHealth, PlaceReached, ReportedState, VehicleEvent, Vertical
from tests.make.records import report_of
from tests.sim_replay.conversation import Conversation

pytestmark = pytest.mark.skipif(
    find_spec("imcpy") is None, reason="imcpy, the peer, is not installed: pip install imcpy"
)

GOAL = GoTo(41.185, -8.706, Vertical("altitude", 5.0), 1.5, 3.0)
DEADLINE_S = 20.0

# Uses nothing of this package. Reports on its output what it took, as JSON, once it has control back.
PEER = r"""
import json, socket
import imcpy

wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
wire.bind(("127.0.0.1", 0))
wire.settimeout(20.0)
print(wire.getsockname()[1], flush=True)
taken = []


def say(message, to, host):
    message.src, message.src_ent, message.dst, message.dst_ent = 0x1E, 38, to, 255
    message.set_timestamp_now()
    wire.sendto(imcpy.Packet.serialize(message), host)


while True:
    data, host = wire.recvfrom(65536)
    message = imcpy.Packet.deserialize(data)
    name, us = type(message).__name__, message.src
    assert message.dst in (0x1E, 0xFFFF)
    if name == "Heartbeat":
        announce = imcpy.Announce()
        announce.sys_name, announce.sys_type, announce.owner = "imcpy", 2, 0xFFFF
        say(announce, 0xFFFF, host)
        state = imcpy.EstimatedState()
        state.lat, state.lon, state.x, state.y, state.depth, state.alt = 0.7188, -0.152, 10.0, 20.0, 12.0, 5.0
        say(state, 0xFFFF, host)
        plans = imcpy.PlanControlState()
        plans.state, plans.plan_id = 3, "survey"
        if not taken:
            say(plans, 0xFFFF, host)
    elif name == "PlanControl":
        follow = message.arg.maneuvers[0].data
        taken.append([name, message.type, message.op, message.plan_id, follow.control_src, follow.timeout])
        answer = imcpy.PlanControl()
        answer.type, answer.op, answer.request_id, answer.plan_id = 1, message.op, message.request_id, message.plan_id
        say(answer, us, host)
        state = imcpy.FollowRefState()
        state.control_src, state.control_ent = follow.control_src, follow.control_ent
        state.state, state.proximity = 1, 1
        say(state, us, host)
    elif name == "Reference":
        if message.flags & 0x80:
            taken.append([name, "done"])
            break
        z = message.z
        taken.append([name, message.flags, message.lat, message.lon, message.speed.value, z.value, z.z_units])
        state = imcpy.FollowRefState()
        state.control_src, state.control_ent, state.state, state.proximity, state.reference = us, 255, 3, 6, message
        say(state, us, host)
    elif name == "Target":
        taken.append([name, message.label, message.lat, message.lon, message.z, message.z_units])
    elif name == "EntityState":
        taken.append([name, message.state, message.description])
print(json.dumps(taken, default=int), flush=True)
"""


def test_an_imcpy_vehicle_is_taken_over_commanded_and_left() -> None:
    peer = subprocess.Popen([sys.executable, "-c", PEER], stdout=subprocess.PIPE, text=True)
    try:
        assert peer.stdout is not None
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
            wire.connect(("127.0.0.1", int(peer.stdout.readline())))
            events = talk_to(wire)
        taken = json.loads(peer.stdout.readline())
        assert peer.wait(DEADLINE_S) == 0
    finally:
        peer.kill()
        peer.communicate()
    assert [type(event) for event in events if not isinstance(event, ReportedState)] == [Granted, PlaceReached]
    state = next(event for event in events if isinstance(event, ReportedState))
    assert (state.depth_m, state.altitude_m) == (12.0, 5.0)
    assert state.latitude_deg == pytest.approx(math.degrees(0.7188) + 10.0 / 111_000.0, abs=1e-5)
    by_name = {name: values for name, *values in taken if values != ["done"]}
    assert by_name["PlanControl"] == [0, 0, PLAN_ID, 0x6000, 5.0]
    assert by_name["Reference"] == pytest.approx([7, math.radians(41.185), math.radians(-8.706), 1.5, 5.0, 2])
    assert by_name["Target"] == [
        "MLC-00003",
        pytest.approx(math.radians(41.186)),
        pytest.approx(math.radians(-8.707)),
        18.5,
        1,
    ]
    assert by_name["EntityState"] == [1, "all is well"]
    assert taken[-1] == ["Reference", "done"]


def talk_to(wire: socket.socket) -> list[VehicleEvent]:
    """Over the wire: request control, report, go to the goal, and release control there."""
    dialect = Conversation(ImcSettings())
    dialect.connected(time.monotonic())
    dialect.request(time.monotonic())
    dialect.report(report_of(latitude_deg=41.186, longitude_deg=-8.707, depth_m=18.5), 1, time.monotonic())
    dialect.report_health(PayloadHealth("normal", "all is well"), time.monotonic())
    events: list[VehicleEvent] = []
    until_s = time.monotonic() + DEADLINE_S
    while time.monotonic() < until_s:
        for item in dialect.take_outgoing(time.monotonic()):
            wire.send(item)
        if PlaceReached() in events:
            dialect.release("done", time.monotonic())
            for item in dialect.take_outgoing(time.monotonic()):
                wire.send(item)
            return events
        if select.select([wire], [], [], 0.05)[0]:
            heard = dialect.hear(wire.recv(65536), Stamp(time.monotonic_ns(), time.time_ns()))
            if any(isinstance(event, Granted) for event in heard):
                dialect.command(GOAL, time.monotonic())
            events += heard
    raise AssertionError(f"not there after {DEADLINE_S} s; events were {events}")
