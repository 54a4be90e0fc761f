"""IMC messages: the records, against golden bytes and against imcpy."""

from __future__ import annotations

import math
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.vehicle import imc_messages as imc
from drivers.vehicle.dialect import ContactReport
from drivers.vehicle.imc_codec import (
    LAYOUTS,
    MAX_DEPTH,
    MAX_TEXT_BYTES,
    Many,
    Numbers,
    One,
    Order,
    decode,
    encode,
    in_limits,
    number_of,
)
from drivers.vehicle.imc_contact import CLASSES, imc_contact_of, report_from_imc, target_of
from drivers.vehicle.imc_messages import ImcMessage
from drivers.vehicle.imc_wire import HEADER_BYTES, ImcPacket, packed, to_wire
from tests.make.records import report_of

NEEDS_IMCPY = pytest.mark.skipif(
    find_spec("imcpy") is None, reason="imcpy, the oracle, is not installed: pip install imcpy"
)
OWN = (imc.MineContact, imc.MineContactTaken)
TIME_S = 1_700_000_000.25

OF_VEHICLE = (imc.EstimatedState, imc.Abort, imc.PlanControlState, imc.VehicleState, imc.FollowRefState, imc.Announce)

# Made with imcpy 1.1.2 at TIME_S: from source 0x6000/5 to 0x001E, those of a vehicle from 0x001E/38 to anyone.
GOLDEN: dict[str, ImcMessage] = {
    "54fe9600000000001040fc54d9410060051e00ff4a31": imc.Heartbeat(),
    "54fe5e01580000001040fc54d9411e0026ffffff71ac8bdb6800e73fca32c4b12e6ec3bf00000000"
    "00004841000050c00000000000000000000000000000a03f0000c03f"
    "0000000000000000000000000000000000000000000000000000000000000000000020410000f04002ca": imc.EstimatedState(
        0.7188, -0.1518, x=12.5, y=-3.25, psi=1.25, u=1.5, depth=10.0, alt=7.5
    ),
    "54fe2f02510000001040fc54d9410060051e00ff000007000a006d636d5f7265706c616e00002702"
    "0a006d636d5f7265706c616e00000000000003006d636d01002802"
    "03006d636dde010060ff000020410000704100000040000000000000000000000000d336": imc.PlanControl(
        0,
        0,
        7,
        "mcm_replan",
        arg=imc.PlanSpecification(
            "mcm_replan",
            start_man_id="mcm",
            maneuvers=(imc.PlanManeuver("mcm", imc.FollowReference(0x6000, 255, 10.0, 15.0, 2.0)),),
        ),
    ),
    "54fedf01270000001040fc54d9410060051e00ff079201000000000000f83f009101000040400253"
    "05a3923a01e73f5396218e7571c3bf0000704168f4": (
        imc.Reference(7, imc.DesiredSpeed(1.5), imc.DesiredZ(3.0, 2), 0.7189, -0.1519, 15.0)
    ),
    "54fe2f02400000001040fc54d9410060051e00ff010007000a006d636d5f7265706c616e00003402"
    "0a006d636d5f7265706c616e00040900546f74616c3d3132300000000000000b00706c616e206c6f61646564953b": imc.PlanControl(
        1, 0, 7, "mcm_replan", arg=imc.PlanStatistics("mcm_replan", 0, 4, "Total=120"), info="plan loaded"
    ),
    "54fe2602000000001040fc54d9411e0026ffffff5442": imc.Abort(),
    "54fe30021b0000001040fc54d9411e0026ffffff0107006175765f6d636dffffffff000080bf0000ff"
    "ffffffffff02857c": imc.PlanControlState(1, "auv_mcm", last_outcome=2),
    "54fef401260000001040fc54d9411e0026ffffff00000000ffff0000000000000000ffff0000000000"
    "070061626f727465640000000000000000fe61": imc.VehicleState(0, last_error="aborted"),
    "54fee0012e0000001040fc54d9411e0026ffffff0060ffdf01079201000000000000f83f0091010000"
    "4040025305a3923a01e73f5396218e7571c3bf000070410202e996": imc.FollowRefState(
        0x6000, 255, imc.Reference(7, imc.DesiredSpeed(1.5), imc.DesiredZ(3.0, 2), 0.7189, -0.1519, 15.0), 2, 2
    ),
    "54fe9700210000001040fc54d9411e0026ffffff06006c6175762d3102ffff5305a3923a01e73f5396"
    "218e7571c3bf00000000000000b6": imc.Announce("lauv-1", 2, lat=0.7189, lon=-0.1519),
    "54fe0100180000001040fc54d9410060051e00ff020014007468657265206973206e6f20706f736974696f6e074e": imc.EntityState(
        2, 0, "there is no position"
    ),
    "54fe2003270000001040fc54d9410060051e00ff08004d4c432d303030315305a3923a01e73f5396"
    "218e7571c3bf00009441010000000000000000ba36": (imc.Target("MLC-0001", 0.7189, -0.1519, 18.5, 1)),
}


@pytest.mark.parametrize(("golden", "message"), GOLDEN.items(), ids=lambda value: type(value).__name__)
def test_golden_bytes_are_read_and_written(golden: str, message: ImcMessage) -> None:
    wired = bytes.fromhex(golden)
    source, entity, to = (0x1E, 38, 0xFFFF) if isinstance(message, OF_VEHICLE) else (0x6000, 5, 0x1E)
    assert packed(message, source, entity=entity, to=to, time_s=TIME_S) == wired
    payload = wired[HEADER_BYTES:-2]
    number = int.from_bytes(wired[2:4], "little")
    assert decode(number, payload) == message
    assert encode(decode(number, payload)) == payload


SINGLE = st.floats(width=32)
NUMBERS: dict[str, st.SearchStrategy[Any]] = {
    "B": st.integers(0, 0xFF),
    "H": st.integers(0, 0xFFFF),
    "I": st.integers(0, 0xFFFFFFFF),
    "i": st.integers(-(2**31), 2**31 - 1),
    "f": SINGLE,
    "d": st.floats(),
}
ANY_KIND = [layout.kind for layout in LAYOUTS.values() if layout.kind not in OWN]


def made(kind: type[Any], depth: int) -> st.SearchStrategy[Any]:
    """Any record of a kind, with others inside it down to a depth."""

    def inner(wanted: type[Any] | None) -> st.SearchStrategy[Any]:
        kinds = ANY_KIND if wanted is None else [wanted]
        return st.sampled_from(kinds).flatmap(lambda chosen: made(chosen, depth - 1))

    fields: list[st.SearchStrategy[Any]] = []
    for part in LAYOUTS[number_of(kind)].parts:
        if kind is imc.PlanSpecification and len(fields) == kind.__struct_fields__.index("variables"):
            fields.append(st.just(()))  # of a kind that no layout here describes, and imcpy takes no other
        elif isinstance(part, Numbers):
            fields += [NUMBERS[code] for code in part.layouts["<"].format[1:]]
        elif isinstance(part, One):
            fields.append(st.none() | inner(part.kind) if depth > 0 else st.none())
        elif isinstance(part, Many):
            fields.append(st.lists(inner(part.kind), max_size=2).map(tuple) if depth > 0 else st.just(()))
        else:
            fields.append(st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12))
    return st.tuples(*fields).map(lambda values: _without_variables(kind(*values)))


def _without_variables(message: Any) -> Any:
    """A plan's variables are PlanVariables alone, which are not known here and so cannot be made."""
    return msgspec.structs.replace(message, variables=()) if isinstance(message, imc.PlanSpecification) else message


MESSAGES = st.sampled_from([layout.kind for layout in LAYOUTS.values()]).flatmap(lambda kind: made(kind, 2))


@given(message=MESSAGES, order=st.sampled_from(["<", ">"]))
def test_what_is_written_is_read_again_in_either_byte_order(message: ImcMessage, order: Order) -> None:
    payload = encode(message, order)
    again = decode(number_of(type(message)), payload, order)
    assert repr(again) == repr(message)  # NaN is not equal to itself
    assert in_limits(number_of(type(message)), len(payload))


def reported_by_imcpy(message: ImcMessage) -> Any:
    """The same message as an object of imcpy."""
    other = getattr(import_module("imcpy"), type(message).__name__)()
    for name in message.__struct_fields__:
        value = getattr(message, name)
        if isinstance(value, tuple):
            for inner in value:
                getattr(other, name).append(reported_by_imcpy(inner))
        elif isinstance(value, msgspec.Struct):
            setattr(other, name, reported_by_imcpy(value))  # type: ignore[arg-type]  # only messages are inside one
        elif value is not None:
            setattr(other, name, value)
    return other


@NEEDS_IMCPY
@given(message=st.sampled_from(ANY_KIND).flatmap(lambda kind: made(kind, 2)))
def test_imcpy_writes_and_reads_the_same(message: ImcMessage) -> None:
    imcpy = import_module("imcpy")
    other = reported_by_imcpy(message)
    other.src, other.src_ent, other.dst, other.dst_ent, other.timestamp = 0x6000, 5, 0x1E, 255, TIME_S
    wired = packed(message, 0x6000, entity=5, to=0x1E, time_s=TIME_S)
    assert wired == imcpy.Packet.serialize(other)
    turned = to_wire(ImcPacket(number_of(type(message)), encode(message, ">"), 0x6000, 5, 0x1E, 255, TIME_S, ">"))
    for either in (wired, turned):
        assert imcpy.Packet.serialize(imcpy.Packet.deserialize(either)) == wired


@given(number=st.sampled_from(sorted(LAYOUTS)), payload=st.binary(max_size=200), order=st.sampled_from(["<", ">"]))
def test_any_payload_is_a_message_or_refused_as_such(number: int, payload: bytes, order: Order) -> None:
    with suppress(ValueError):
        assert number_of(type(decode(number, payload, order))) == number


@given(message=MESSAGES, data=st.data())
def test_a_damaged_payload_is_a_message_or_refused(message: ImcMessage, data: st.DataObject) -> None:
    payload = bytearray(encode(message))
    for _ in range(data.draw(st.integers(1, 3))):
        if payload:
            payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.sampled_from([0, 1, 0x7F, 0xFF]))
    cut = bytes(payload[: data.draw(st.integers(0, len(payload)))])
    for damaged in (bytes(payload), cut):
        with suppress(ValueError):
            assert type(decode(number_of(type(message)), damaged)) is type(message)


def test_messages_inside_messages_end_somewhere() -> None:
    message = imc.PlanControl(0, 0, 1, "")
    for _ in range(MAX_DEPTH):
        message = imc.PlanControl(0, 0, 1, "", arg=message)
    assert decode(559, encode(message)) == message
    with pytest.raises(ValueError, match="deeper"):
        decode(559, encode(imc.PlanControl(0, 0, 1, "", arg=message)))


def test_a_long_list_that_is_not_there_is_refused() -> None:
    with pytest.raises(ValueError, match="early"):
        decode(553, encode(imc.PlanTransition("", ""))[:-2] + b"\xff\xff")


def test_a_message_inside_another_must_be_of_the_kind_that_belongs_there() -> None:
    with pytest.raises(ValueError, match="inside another"):
        decode(480, b"\0\x60\xff" + (800).to_bytes(2, "little") + encode(imc.Target("", 0.0, 0.0)) + b"\2\1")


@pytest.mark.parametrize("start", ["", "a"])
def test_long_texts_are_cut_between_characters(start: str) -> None:
    again = decode(1, encode(imc.EntityState(1, 0, start + "ä" * 5000)))
    assert isinstance(again, imc.EntityState)
    assert again.description == start + "ä" * ((MAX_TEXT_BYTES - len(start)) // 2)


def a_report(**changes: Any) -> ContactReport:
    known: dict[str, Any] = {
        "time_s": TIME_S,
        "latitude_deg": 41.125,
        "longitude_deg": -8.75,
        "classification": "wedge",
        "belief": {"wedge": 0.5, "clutter": 0.25, "unknown": 0.25},
        "depth_m": 18.5,
        "length_m": 1.25,
        "width_m": 0.5,
        "length_sigma_m": 0.125,
    }
    return report_of(**{"revision": 2, "n_views": 2, **known, **changes})


def test_a_report_goes_through_the_message_whole() -> None:
    report = a_report()
    contact = imc_contact_of(report)
    assert decode(1700, encode(contact, ">"), ">") is not None
    reported = report_from_imc(contact)
    assert reported.belief == {name: report.belief.get(name, 0.0) for name in CLASSES}
    for name in report.__struct_fields__:
        if name != "belief":
            assert getattr(reported, name) == pytest.approx(getattr(report, name), abs=1e-12, nan_ok=True), name
    assert len(encode(contact)) == 97


def test_no_report_is_too_large_to_be_reported() -> None:
    wired = encode(
        imc_contact_of(a_report(session=2**63, number=2**40, revision=70_000, n_views=10**6, sigma_m=math.inf))
    )
    assert encode(decode(1700, wired)) == wired


def test_a_class_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="class 6"):
        report_from_imc(msgspec.structs.replace(imc_contact_of(a_report()), classification=6))


def test_a_target_has_name_place_and_depth() -> None:
    assert target_of(a_report()) == imc.Target("MLC-00003", math.radians(41.125), math.radians(-8.75), 18.5, 1)
    assert target_of(a_report(depth_m=math.nan)).z_units == 0
