"""When the law of a recorder is decided, doubted and changed."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec import structs

from auv_mcm.records import Notice, Ping, Transfer
from auv_mcm.settings.config import SonarConfig
from auv_mcm.waterfall.floor_speckle import floor_speckle
from auv_mcm.waterfall.law_watch import LawVerdict, LawWatch, measure_block
from auv_mcm.waterfall.sample_law import sample_law
from tests.auv_mcm.waterfall.law_pings import intensity_pings, log_counts, pings

AMPLITUDE = 60.0 * np.sqrt(intensity_pings(1, "spreading", n_pings=512))
LOGARITHM = log_counts(intensity_pings(4, "spreading", n_pings=512, seed=2), 0.314)


def verdicts_of(watch: LawWatch, given: list[Ping]) -> list[tuple[int, LawVerdict]]:
    found = [(ping.number, verdict) for ping in given if (verdict := watch.add(ping)) is not None]
    last = watch.finish()
    return found if last is None else [*found, (-1, last)]


def notices_of(sonar: SonarConfig, given: list[Ping]) -> list[Notice]:
    return [notice for _, verdict in verdicts_of(LawWatch(sonar), given) for notice in verdict.notices]


def test_several_hundred_pings_decide_and_the_notice_states_the_odds() -> None:
    (number, (transfer, (notice,))), *more = verdicts_of(LawWatch(SonarConfig()), pings(LOGARITHM))
    assert number == 255
    assert transfer is not None
    assert transfer.kind == "log"
    assert transfer.db_per_count == pytest.approx(0.314, rel=0.45)
    assert notice.code == "transfer.chosen"
    assert "logarithms by odds of over 1000 to 1 from 256 pings" in notice.text
    assert notice.for_the_record
    assert not more


def test_a_sonar_that_sends_to_one_side_at_a_time_is_read_as_any_other() -> None:
    in_turn = [
        structs.replace(ping, port=None, starboard=ping.port) if ping.number % 2 else ping for ping in pings(LOGARITHM)
    ]
    (_, (transfer, (notice,))), *more = verdicts_of(LawWatch(SonarConfig()), in_turn)
    assert transfer is not None
    assert transfer.kind == "log"
    assert notice.code == "transfer.chosen"
    assert not more


@pytest.mark.parametrize("share", [0.1, 0.3])
@pytest.mark.parametrize("sides", ["port", "both"])
def test_pings_that_came_to_nothing_leave_the_law_as_it_is(share: float, sides: str) -> None:
    """Zeros stand for them."""
    lost = np.random.default_rng(3).random(1024) < share
    samples = (60.0 * np.sqrt(intensity_pings(4, "spreading", n_pings=1024))).astype(np.uint16)
    damaged = np.where(lost[:, np.newaxis], 0, samples)
    other_side = pings(damaged if sides == "both" else samples)
    given = [
        structs.replace(ping, starboard=other.port) for ping, other in zip(pings(damaged), other_side, strict=True)
    ]
    (_, (transfer, (notice,))), *more = verdicts_of(LawWatch(SonarConfig()), given)
    assert transfer is not None
    assert transfer.kind == "amplitude"
    assert transfer.intensity_power == pytest.approx(2.0, abs=0.3)
    assert "by odds of" in notice.text
    assert not more


def test_a_law_that_stays_open_is_read_as_amplitude_after_twice_as_many_pings_and_a_person_is_asked() -> None:
    """Spread as little as logarithms are, and skewed upwards as only linear samples are."""
    random = np.random.default_rng(5)
    odd = np.rint(100.0 + 1.7 * (random.gamma(34.6, 1.0, (600, 1200)) - 34.6)).astype(np.uint8)
    number, verdict = verdicts_of(LawWatch(SonarConfig()), pings(odd))[0]
    assert not sample_law(floor_speckle([measure_block(pings(odd)[:16])])).is_sure
    assert number == 511
    assert verdict.transfer == Transfer("amplitude", power=2.0)
    (notice,) = verdict.notices
    assert not notice.for_the_record
    assert "set sonar.transfer" in notice.text


def test_a_decisive_choice_without_decibels_needs_no_action() -> None:
    (notice,) = notices_of(SonarConfig(), pings(AMPLITUDE))
    assert notice.code == "transfer.chosen"
    assert notice.for_the_record


def test_rare_pings_do_not_make_contacts_wait_for_minutes() -> None:
    slow = pings(AMPLITUDE[:200], rate_hz=1.0)
    number, verdict = verdicts_of(LawWatch(SonarConfig()), slow)[0]
    assert 63 <= number <= 79
    assert verdict.transfer is not None
    assert verdict.transfer.kind == "amplitude"


@pytest.mark.parametrize("n_sides", [1, 2])
@pytest.mark.parametrize("wrong", [0, 1, 63, 240, 520])
def test_one_wrong_time_changes_no_decision(wrong: int, n_sides: int) -> None:
    """Neither when the law is decided nor when it turns, at ping 512, where another recorder speaks without a hole."""
    given = pings(AMPLITUDE.astype(np.uint8)) + pings(LOGARITHM, first=512)
    damaged = list(given)
    for place in range(wrong, wrong + n_sides):
        damaged[place] = structs.replace(given[place], time_s=given[wrong].time_s + 1e6)
    expected = [number for number, _ in verdicts_of(LawWatch(SonarConfig()), given)]
    assert [number for number, _ in verdicts_of(LawWatch(SonarConfig()), damaged)] == expected


def test_a_short_record_is_decided_at_its_end() -> None:
    ((number, verdict),) = verdicts_of(LawWatch(SonarConfig()), pings(AMPLITUDE[:48]))
    assert number == -1
    assert verdict.transfer is not None
    assert verdict.transfer.kind == "amplitude"


def test_without_speckle_the_commonest_is_used_and_the_notice_states_it() -> None:
    for sonar, kind in ((SonarConfig(), "amplitude"), (SonarConfig(transfer="log"), "log")):
        ((_, verdict),) = verdicts_of(LawWatch(sonar), pings(np.full((40, 100), 7, dtype=np.uint8)))
        assert verdict.transfer is not None
        assert verdict.transfer.kind == kind
    assert [notice.code for notice in notices_of(SonarConfig(), pings(np.full((40, 100), 7, dtype=np.uint8)))] == [
        "transfer.unchecked"
    ]


@pytest.mark.parametrize("gap_s", [0.0, 60.0])
def test_the_law_turns_when_another_recorder_speaks(gap_s: float) -> None:
    """As where logs of two recorders are replayed as one mission, with a hole in time or without."""
    later = pings(LOGARITHM, first=512 + round(10.0 * gap_s))
    (_, first), (number, turned), *more = verdicts_of(
        LawWatch(SonarConfig()), pings(AMPLITUDE.astype(np.uint8)) + later
    )
    assert first.transfer is not None
    assert first.transfer.kind == "amplitude"
    assert turned.transfer is not None
    assert turned.transfer.kind == "log"
    assert turned.transfer.db_per_count == pytest.approx(0.314, rel=0.45)
    assert number - later[0].number <= (64 if gap_s else 512)
    assert [notice.code for notice in turned.notices] == ["transfer.turned"]
    assert turned.notices[0].place == f"ping {number}"
    assert not more


@pytest.mark.parametrize("step_s", [2.5, 20.0])
def test_a_hole_is_noticed_before_pings_that_come_more_rarely(step_s: float) -> None:
    before, behind = pings(AMPLITUDE.astype(np.uint8)), pings(LOGARITHM)
    later = [structs.replace(one, time_s=one.time_s + 3600.0 + step_s * n) for n, one in enumerate(behind)]
    (_, _), (number, turned) = verdicts_of(LawWatch(SonarConfig()), before + later)
    assert turned.transfer is not None
    assert number <= 66, "its own 64 pings decide, without those before the hole"


def test_a_configured_law_that_fits_is_used_at_once_and_never_doubted() -> None:
    for sonar, samples in (
        (SonarConfig(transfer="amplitude"), AMPLITUDE),
        (SonarConfig(transfer="log", db_per_count=0.314), LOGARITHM),
        (SonarConfig(transfer="intensity"), intensity_pings(4, "spreading", n_pings=512)),
    ):
        ((number, verdict),) = verdicts_of(LawWatch(sonar), pings(samples))
        assert number == 0
        assert verdict.transfer is not None
        assert verdict.transfer.kind == sonar.transfer
        assert not verdict.notices


def test_a_configured_law_is_kept_and_doubted_once_on_strong_evidence() -> None:
    (notice,) = notices_of(SonarConfig(transfer="amplitude"), pings(LOGARITHM))
    assert notice.code == "transfer.disagrees"
    assert "sonar.transfer is 'amplitude' but the samples look like 'log' of" in notice.text
    assert "(odds over 1000 to 1)" in notice.text
    (notice,) = notices_of(SonarConfig(transfer="log", db_per_count=0.5), pings(AMPLITUDE))
    assert notice.code == "transfer.disagrees"
    (notice,) = notices_of(SonarConfig(transfer="log", db_per_count=1.5), pings(LOGARITHM))
    assert notice.code == "transfer.db_per_count"


def test_pings_seconds_apart_are_no_holes_in_time() -> None:
    (notice,) = notices_of(SonarConfig(transfer="amplitude"), pings(LOGARITHM, rate_hz=0.3))
    assert notice.code == "transfer.disagrees"
    assert notice.place == "ping 255"


def test_a_short_record_of_a_configured_law_is_doubted_at_its_end() -> None:
    (notice,) = notices_of(SonarConfig(transfer="amplitude"), pings(LOGARITHM[:128]))
    assert notice.code == "transfer.disagrees"


def test_a_logarithm_whose_decibels_are_left_open_is_doubted_with_the_first_decision() -> None:
    ((_, verdict),) = verdicts_of(LawWatch(SonarConfig(transfer="log")), pings(AMPLITUDE[:300]))
    assert verdict.transfer is not None
    assert verdict.transfer.kind == "log"
    assert [notice.code for notice in verdict.notices] == ["transfer.disagrees"]


def test_what_the_protocol_states_beats_speckle_but_not_the_configuration() -> None:
    stated = pings(LOGARITHM, transfer="intensity")
    watch = LawWatch(SonarConfig())
    assert watch.add(stated[0]) == LawVerdict(Transfer("intensity"), ())
    (notice,) = notices_of(SonarConfig(), stated)
    assert notice.code == "transfer.disagrees"
    assert "the sonar's protocol states 'intensity'" in notice.text
    first = LawWatch(SonarConfig(transfer="amplitude")).add(stated[0])
    assert first == LawVerdict(Transfer("amplitude"), ())


@pytest.mark.parametrize(("gap_s", "turns"), [(0.1, 0), (60.0, 1)])
def test_the_power_is_raised_for_another_recorder_and_not_on_the_way(gap_s: float, turns: int) -> None:
    """What roots of amplitude look like, some sea floor does, too."""
    root = AMPLITUDE**0.7
    first = pings(np.concatenate([AMPLITUDE, AMPLITUDE]))
    late = [structs.replace(ping, time_s=ping.time_s + gap_s) for ping in pings(np.concatenate([root, root]), 1024)]
    (_, (transfer, _)), *more = verdicts_of(LawWatch(SonarConfig()), [*first, *late])
    assert transfer == Transfer("amplitude", power=2.0)
    assert [notice.code for _, verdict in more for notice in verdict.notices] == ["transfer.turned"] * turns


def test_the_power_is_lowered_on_the_way() -> None:
    root = AMPLITUDE**0.7
    given = pings(np.concatenate([root, root, AMPLITUDE, AMPLITUDE]))
    (_, (first, _)), (_, (turned, _)) = verdicts_of(LawWatch(SonarConfig()), given)
    assert first is not None
    assert turned is not None
    assert first.intensity_power > 2.4
    assert turned == Transfer("amplitude", power=2.0)
