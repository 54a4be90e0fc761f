"""Nothing goes on a wire that the guard did not judge by its bytes, and nothing leads towards the sea floor."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Any

import pytest

from auv_mcm.settings.vehicle_settings import CanSettings, ImcSettings, IverSettings
from drivers.navigation.nmea0183 import sentence
from drivers.vehicle.can_messages import GoToMessage, encode
from drivers.vehicle.dialect import GoTo, ReadsBack, Steer, Vertical, WireCommand, numbers_of
from drivers.vehicle.imc_messages import DesiredSpeed, DesiredZ, Heartbeat, Reference, RefFlag
from drivers.vehicle.imc_wire import packed
from drivers.vehicle.talkers.can_talker import CanTalker
from drivers.vehicle.talkers.imc_talker import ImcTalker
from drivers.vehicle.vehicles import VEHICLES, talker_of
from tests.drivers.vehicle.wire_history import (
    FLOOR_M,
    LONG_S,
    Event,
    History,
    Voyage,
    drawn,
    fly,
    fly_voyage,
    settings_of,
)

EVERY = pytest.mark.parametrize("name", sorted(VEHICLES))
DEPTHS_ALONE = pytest.mark.parametrize("name", ["iver", "recon"])
N_HISTORIES = 60  # of each dialect

# Each leads towards the floor where an altitude that stands still is believed while the depth grows by up to 1 m, the
# first where it is believed while the depth is held.
STOOD_STILL = (
    History(LONG_S, -0.3, 0.02, 1, (Event("frozen_altitude", 5.0, 25.0, 0.0),), 12.0),
    History(LONG_S, 0.3, 0.02, 222665156, (Event("frozen_altitude", 11.05, 7.55, 0.0),)),
    History(LONG_S, 0.3, 0.02, 1, (Event("swap", 8.0, 3.0, 0.0), Event("frozen_altitude", 11.0, 8.0, 0.0))),
    History(
        LONG_S,
        -0.3,
        0.1,
        805264436,
        (
            Event("frozen_altitude", 18.57, 12.5, 1.0),
            Event("false_then_lost", 18.57, 2.44, -0.85),
            Event("frozen", 21.0, 2.32, 1.0),
        ),
    ),
)


@EVERY
def test_no_command_leads_towards_the_true_floor_whatever_the_vehicle_reports(name: str) -> None:
    """Histories of fixed seeds: what hypothesis draws depends on which modules are imported, its own seed or not."""
    for seed in range(N_HISTORIES):
        history = drawn(random.Random(seed), LONG_S)
        wrong, _ = fly(name, [history])
        assert wrong == [], f"seed {seed}: {history}"


@DEPTHS_ALONE
@pytest.mark.parametrize("history", STOOD_STILL)
def test_an_altitude_that_stands_still_leads_nobody_to_the_floor(name: str, history: History) -> None:
    wrong, _ = fly(name, [history])
    assert wrong == []


@pytest.mark.parametrize("number", [2852, 3358, 4018])
def test_a_depth_or_an_altitude_that_stands_still_after_others_leads_nobody_to_the_floor(number: int) -> None:
    """Before, a swap and then a frozen depth, and a frozen altitude late or after a spike, led within 2 m of it."""
    _, wrong = fly_voyage(number)
    assert wrong == []


def report(voyage: Voyage, for_s: float, altitude_m: Callable[[float], float], rises_mps: float = 0.0) -> None:
    """Report true depths, wavering by 3 cm, and an altitude made of the true one, over a floor that rises."""
    for step in range(round(for_s / 0.1)):
        voyage.floor_m -= rises_mps * 0.1
        altitude = altitude_m(voyage.floor_m - voyage.depth_m)
        for sent in voyage.step(0.1, depth_m=voyage.depth_m + 0.03 * (step % 2), altitude_m=altitude):
            assert sent.depth_m is None or sent.depth_m <= voyage.floor_m - 2.0


@EVERY
@pytest.mark.parametrize("rises_mps", [0.0, 0.75])
def test_an_altitude_that_freezes_while_the_depth_is_held_is_noticed_and_leads_up(name: str, rises_mps: float) -> None:
    """Before, an Iver was commanded 2 m below the floor."""
    voyage = Voyage(name, ask_again_s=1.0)
    voyage.run(15.0)
    assert voyage.pilot.authority == "granted"
    frozen_m = voyage.floor_m - voyage.depth_m
    report(voyage, 8.0, lambda true_m: frozen_m, rises_mps)
    assert voyage.pilot.authority != "granted"
    assert voyage.pilot.counters["vehicle.refused.floor_unknown"] == 1
    assert (
        "look after its altimeter" in [n.text for n in voyage.pilot.take_notices() if n.code == "vehicle_refused"][-1]
    )
    n_commands = len(voyage.commands)
    report(voyage, 5.0, lambda true_m: frozen_m)
    assert len(voyage.commands) == n_commands


@EVERY
@pytest.mark.parametrize("digits_m", [0.1, 1.0])
def test_coarse_digits_over_a_level_floor_end_no_command_and_lead_up_by_less_than_2_m(
    name: str, digits_m: float
) -> None:
    voyage = Voyage(name, ask_again_s=1.0)
    voyage.run(15.0)
    for _ in range(10):
        report(voyage, 1.0, lambda true_m: round(true_m / digits_m) * digits_m)
        assert voyage.pilot.authority == "granted"
        assert 3.9 <= voyage.floor_m - voyage.depth_m <= 7.0
    assert voyage.pilot.counters["vehicle.altitudes_doubted"] > 0


@EVERY
def test_the_histories_do_see_commands(name: str) -> None:
    undisturbed = History(LONG_S, 0.1, 0.02, 1, ())
    wrong, n_commands = fly(name, [undisturbed])
    assert wrong == []
    assert n_commands >= 15


def glitch(voyage: Voyage, *, depth_m: float, altitude_m: float, for_s: float) -> None:
    """Report something else for a while."""
    voyage.run(for_s, depth_m=depth_m, altitude_m=altitude_m)


@DEPTHS_ALONE
@pytest.mark.parametrize("begins_s", [0.0, 0.3, 0.6, 0.9])
def test_a_false_depth_and_then_no_altitude_lead_nobody_to_the_floor(name: str, begins_s: float) -> None:
    """Attack `iver_floor_min.py`: it sent a depth of 93 m over 18 m of water."""
    voyage = Voyage(name)
    voyage.run(8.0 + begins_s)
    assert voyage.pilot.authority == "granted"
    glitch(voyage, depth_m=90.0, altitude_m=8.0, for_s=0.5)
    glitch(voyage, depth_m=10.0, altitude_m=0.0, for_s=3.0)
    voyage.run(3.0)
    depths_m = [command.depth_m for command in voyage.commands if command.depth_m is not None]
    assert depths_m
    assert max(depths_m) <= FLOOR_M - 5.0


@DEPTHS_ALONE
def test_a_depth_that_is_false_again_and_again_stays_within_its_maximum(name: str) -> None:
    """Attack `pilotfuzz2.py`: depths of 203 m and 5003 m went out with `max_depth_m: 60`."""
    voyage = Voyage(name, ask_again_s=1.0, max_depth_m=60.0)
    for false_m in (60.5, 99.0, 200.0, 5000.0, 58.5):
        voyage.run(6.0)
        glitch(voyage, depth_m=false_m, altitude_m=8.0, for_s=0.2)
        glitch(voyage, depth_m=10.0, altitude_m=0.0, for_s=3.0)
    depths_m = [command.depth_m for command in voyage.commands if command.depth_m is not None]
    assert max(depths_m) <= FLOOR_M - 5.0


@DEPTHS_ALONE
def test_a_vehicle_without_altitude_is_commanded_a_safe_depth_before_control_goes_back(name: str) -> None:
    voyage = Voyage(name, command_valid_s=2.0)
    voyage.run(8.0)
    assert voyage.last_depth_m == pytest.approx(FLOOR_M - 5.0, abs=0.1)
    glitch(voyage, depth_m=10.0, altitude_m=0.0, for_s=5.0)
    assert voyage.pilot.authority != "granted"
    assert voyage.pilot.counters["vehicle.led_up"] == 1
    holds_s = IverSettings().command_timeout_s if name == "iver" else 2.0
    slope_m = 0.5 * 1.5 * (6.5 + holds_s)  # of the floor since it was seen, and while the vehicle may hold the depth
    assert voyage.last_depth_m <= FLOOR_M - 5.0 - slope_m + 0.1
    n_commands = len(voyage.commands)
    voyage.run(3.0)
    assert len(voyage.commands) == n_commands


def test_a_vehicle_that_comes_too_low_is_led_up() -> None:
    voyage = Voyage("iver")
    voyage.run(8.0)
    glitch(voyage, depth_m=16.5, altitude_m=1.5, for_s=1.0)
    assert voyage.last_depth_m < FLOOR_M - 5.0 - 3.0
    assert voyage.pilot.counters["vehicle.led_up"] == 1


def test_a_depth_that_goes_on_the_wire_is_judged_also_where_its_talker_changed_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    voyage = Voyage("iver")
    voyage.run(8.0)
    talker: Any = voyage.talker
    steer = talker._steer
    monkeypatch.setattr(
        talker, "_steer", lambda order, now_s: steer(order._replace(vertical=Vertical("depth", 17.0)), now_s)
    )
    n_commands = len(voyage.commands)
    voyage.run(3.0)
    assert [command.depth_m for command in voyage.commands[n_commands:]] == []
    assert voyage.pilot.authority != "granted"
    assert voyage.pilot.counters["vehicle.refused.commands_too_low"] == 1


@EVERY
def test_a_command_without_a_grant_does_not_leave(name: str) -> None:
    voyage = Voyage(name, command=False)
    voyage.run(3.0)
    talker: Any = voyage.talker
    talker.take_outgoing = lambda now_s: list(command_items(name))
    assert voyage.pilot.take_outgoing(voyage.now_s) == []


@EVERY
def test_a_message_that_cannot_be_read_does_not_leave(name: str) -> None:
    voyage = Voyage(name, ask_again_s=1.0)
    voyage.run(12.0)
    talker: Any = voyage.talker
    sent = talker.take_outgoing
    talker.take_outgoing = lambda now_s: [*sent(now_s), command_items(name)[0] if name == "vehicle_can" else b"junk"]
    assert voyage.pilot.authority == "granted"
    assert [item for item in voyage.pilot.take_outgoing(voyage.now_s) if item in command_items(name)] == []
    assert voyage.pilot.authority != "granted"
    assert voyage.pilot.counters["vehicle.refused.unreadable"] == 1


@EVERY
def test_every_dialect_reads_back_what_it_sends(name: str) -> None:
    assert isinstance(talker_of(name, settings_of(name), lambda n: 1), ReadsBack)


def command_items(name: str) -> list[Any]:
    """Return a command's messages as this dialect sends them."""
    match name:
        case "imc":
            return [packed(reference(), 0x6000)]
        case "bluefin":
            return [sentence("BPRMB,101010.000,10.00,5.00,1,1.50,1,0")]
        case "iver":
            return [sentence("OMS,10.0,5.0,20.0,2.9,5")]
        case "recon":
            return [b"#C,Depth,Depth,5.00,*70\n"]
    return encode(GoToMessage(48.0, 1.5, -68.0, 3.0, 5.0, 1, 3.0, 1, 1), 96)


def reference(**changes: Any) -> Reference:
    fields: dict[str, Any] = {
        "flags": RefFlag.LOCATION | RefFlag.SPEED | RefFlag.Z,
        "speed": DesiredSpeed(1.5),
        "z": DesiredZ(5.0, 2),
        "lat": math.radians(48.0),
        "lon": math.radians(-68.0),
    }
    return Reference(**{**fields, **changes})


def test_imc_commands_are_read_with_all_their_numbers() -> None:
    talker = ImcTalker(ImcSettings())
    items = [
        packed(reference(), 0x6000),
        packed(Heartbeat(), 0x6000),
        packed(Reference(RefFlag.MANDONE), 0x6000),
        packed(reference(z=DesiredZ(5.0, 3)), 0x6000),
        packed(reference(speed=DesiredSpeed(50.0, 2)), 0x6000),
        packed(reference(lat=math.nan), 0x6000),
        packed(reference(), 0x6000)[:-1],
    ]
    read = talker.commands_in(items)
    assert read[0] == WireCommand(
        place_deg=(pytest.approx(48.0), pytest.approx(-68.0)),  # type: ignore[arg-type]
        vertical=Vertical("altitude", 5.0),
        speed_mps=1.5,
        holds_s=5.0,
    )
    assert read[1] is None
    assert read[2] is None
    heights, percent, nowhere, cut = read[3:]
    assert heights is not None
    assert heights.vertical is not None
    assert math.isnan(heights.vertical.value_m)
    assert percent is not None
    assert math.isnan(percent.speed_mps or 0.0)
    assert nowhere is not None
    assert nowhere.place_deg is not None
    assert math.isnan(nowhere.place_deg[0])
    assert cut == WireCommand()


def test_can_commands_are_read_in_each_of_their_frames() -> None:
    talker = CanTalker(CanSettings())
    frames = command_items("vehicle_can")
    read = talker.commands_in(frames)
    assert len(set(read)) == 1
    assert read[0] == WireCommand(
        place_deg=(pytest.approx(48.0), pytest.approx(-68.0)),  # type: ignore[arg-type]
        radius_m=pytest.approx(3.0),  # type: ignore[arg-type]
        vertical=Vertical("altitude", 5.0),
        speed_mps=pytest.approx(1.5),  # type: ignore[arg-type]
        holds_s=pytest.approx(3.0),  # type: ignore[arg-type]
    )
    assert talker.commands_in(frames[:-1]) == [WireCommand()] * (len(frames) - 1)


@pytest.mark.parametrize("timeout_s", [5, 120])
def test_a_heading_is_sent_only_if_it_stays_inside_the_fence_until_its_time_out(timeout_s: int) -> None:
    narrow_deg = ((47.999, -68.003), (47.999, -67.997), (48.0015, -67.997), (48.0015, -68.003))  # 167 m to the north
    voyage = Voyage("iver", settings=IverSettings(command_timeout_s=timeout_s), fence_deg=narrow_deg)
    voyage.run(10.0)
    assert bool(voyage.commands) == (timeout_s == 5)  # 120 s at 1.5 m/s are 180 m
    assert voyage.pilot.counters["vehicle.refused.leads_out"] == (timeout_s == 120)


def test_numbers_that_are_not_encoded_yet_are_judged_by_the_same_rules() -> None:
    steer = Steer(1.0, Vertical("depth", 5.0), 1.5)
    assert numbers_of(steer) == WireCommand(heading_rad=1.0, vertical=Vertical("depth", 5.0), speed_mps=1.5)
    go_to = GoTo(48.0, -68.0, Vertical("altitude", 5.0), 1.5, 3.0)
    assert numbers_of(go_to).place_deg == (48.0, -68.0)


@DEPTHS_ALONE
def test_a_plan_outlives_the_loss_of_the_floor(name: str) -> None:
    voyage = Voyage(name, ask_again_s=5.0)
    voyage.run(8.0)
    glitch(voyage, depth_m=10.0, altitude_m=0.0, for_s=4.0)
    assert voyage.pilot.counters["vehicle.returned"] == 1
    n_commands = len(voyage.commands)
    voyage.run(15.0)
    assert voyage.pilot.authority == "granted"
    assert len(voyage.commands) > n_commands
    assert voyage.last_depth_m == pytest.approx(FLOOR_M - 5.0, abs=0.1)
