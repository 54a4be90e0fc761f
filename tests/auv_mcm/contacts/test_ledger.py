"""Which views become one contact, anywhere on Earth, and what they say together."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import EVERYTHING, subset, vacuous
from auv_mcm.contacts.ledger import Ledger
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.records import NAN, Confirmation, Contact, ContactClass, Detection, ShapeModel
from auv_mcm.settings.config import ContactsConfig
from tests.auv_mcm.classify import drawn_looks

HOME = LocalFrame(latitude_deg=43.7, longitude_deg=10.3)
FIRST_LEG: dict[str, Any] = {"heading_rad": 0.0, "side": "starboard", "aspect_deg": 90.0}
SECOND_LEG: dict[str, Any] = {"heading_rad": math.pi, "side": "port", "aspect_deg": 90.0}


def view(
    east_m: float, north_m: float, time_s: float, *, frame: LocalFrame = HOME, sigma_m: float = 1.0, **values: Any
) -> Detection:
    """A detection at a place in a local frame."""
    latitude, longitude, _ = frame.to_geodetic(np.array([east_m, north_m, 0.0]))
    known: dict[str, Any] = {
        "row": time_s * 15.0,
        "time_s": time_s,
        "ping_number": int(time_s * 15.0),
        "latitude_deg": float(latitude),
        "longitude_deg": float(longitude),
        "covariance_m2": sigma_m**2 * np.eye(2),
        "length_m": 0.8,
        "width_m": 0.4,
        "height_m": 0.3,
        "reasons": ("highlight_and_shadow",),
    }
    return drawn_looks.detection(**{**known, **FIRST_LEG, **values})


ALL_REPORTED = ContactsConfig(min_p_mine=0.0)
ROW = [(10.0, 0.0), (10.0, 3.0), (10.2, 6.0)]


def ledger() -> Ledger:
    return Ledger(ALL_REPORTED)


def place(contact: Contact | Detection, frame: LocalFrame = HOME) -> NDArray[np.float64]:
    return frame.to_enu(contact.latitude_deg, contact.longitude_deg, 0.0)[:2]


def objects_in(contacts: tuple[Contact, ...]) -> list[set[float]]:
    """List the objects (known by their score) that each contact is made of."""
    return [{v.score for v in contact.views} for contact in contacts]


@pytest.mark.parametrize("offset_m", [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (-0.9, 0.9), (0.0, -1.4)])
@pytest.mark.parametrize("spacing_m", [1.5, 3.0])
def test_two_passes_over_a_row_of_objects_join_one_to_one_though_navigation_is_off(
    offset_m: tuple[float, float], spacing_m: float
) -> None:
    """The navigation offset is common to all objects of a pass and may be nearly the distance between them."""
    objects = [(10.0, spacing_m * k) for k in range(8)]
    book = ledger()
    book.add([view(e, n, 100.0 + n, score=float(k)) for k, (e, n) in enumerate(objects)])
    assert len(book.contacts) == 8
    book.add(
        [
            view(e + offset_m[0], n + offset_m[1], 900.0 - n, score=float(k), **SECOND_LEG)
            for k, (e, n) in enumerate(objects)
        ]
    )
    assert len(book.contacts) == 8
    assert objects_in(book.contacts) == [{float(k)} for k in range(8)]


def test_detections_of_one_passage_never_join_even_at_one_place() -> None:
    book = ledger()
    book.add([view(0.0, 0.0, 100.0), view(0.0, 0.1, 100.1)])
    book.add([view(0.0, 0.05, 101.0, heading_rad=math.radians(40.0))])  # a course that swings is no turn
    book.add([view(0.0, 1.0, 190.0, row=1525.0)])  # nor does who stops come back
    assert len(book.contacts) == 4
    sides = ledger()
    sides.add([view(0.0, 0.0, 100.0, side="port"), view(0.3, 0.0, 100.0, side="starboard")])
    assert len(sides.contacts) == 2


def test_sub_apertures_of_one_passage_are_views_of_the_same_objects() -> None:
    book = ledger()
    for squint_rad in (-0.05, 0.0, 0.05):
        book.add([view(e, n, 100.0 + n, score=float(k), squint_rad=squint_rad) for k, (e, n) in enumerate(ROW)])
    assert objects_in(book.contacts) == [{0.0}, {1.0}, {2.0}]
    assert [len(contact.views) for contact in book.contacts] == [3, 3, 3]
    together = ledger()
    squinted = [(e, n, s) for e, n in ROW for s in (-0.05, 0.0, 0.05)]
    together.add([view(e, n, 100.0 + n, score=n, squint_rad=squint_rad) for e, n, squint_rad in squinted])
    assert [len(contact.views) for contact in together.contacts] == [3, 3, 3]


def test_numbers_that_are_reserved_are_given_to_no_contact() -> None:
    kept = ledger()
    kept.add([view(0.0, 0.0, 0.0)])
    kept.reserve(5)
    kept.reserve(2)
    (opened,) = kept.add([view(500.0, 0.0, 400.0)])
    (joined,) = kept.add([view(0.5, 0.0, 800.0)])
    assert (opened.id, joined.id, len(joined.views)) == ("C00006", "C00001", 2)
    assert [contact.id for contact in kept.contacts] == ["C00001", "C00006"]
    assert kept.asking(0.0) == tuple(contact for contact in kept.contacts if contact.next_look_deg)


@pytest.mark.parametrize("turn_rad", [math.pi, math.radians(-50.0)])
def test_views_before_and_after_a_turn_join_though_they_become_final_together(turn_rad: float) -> None:
    """Short legs: both passes fall into one tile, hence into one batch."""
    book = ledger()
    book.add([view(0.0, 0.0, 100.0, score=1.0), view(0.0, 5.0, 103.0, score=2.0)])
    before = len(book.contacts)
    together = ledger()
    together.add(
        [
            view(0.0, 0.0, 100.0, score=1.0),
            view(0.0, 5.0, 103.0, score=2.0),
            view(0.2, 5.1, 125.0, score=2.0, heading_rad=turn_rad, aspect_deg=270.0),
            view(0.2, 0.1, 128.0, score=1.0, heading_rad=turn_rad, aspect_deg=270.0),
        ]
    )
    assert before == len(together.contacts) == 2
    assert objects_in(together.contacts) == [{1.0}, {2.0}]


def test_a_later_look_is_another_one_though_the_clock_was_set_back_to_the_first() -> None:
    book = ledger()
    book.add([view(0.0, 0.0, 1000.0, score=1.0), view(0.0, 4.0, 1003.0, score=2.0)])
    again = [view(0.2, north_m, 1600.0 + north_m, score=score) for north_m, score in ((0.0, 1.0), (4.0, 2.0))]
    book.add([msgspec.structs.replace(each, time_s=each.time_s - 595.0) for each in again])
    assert objects_in(book.contacts) == [{1.0}, {2.0}]
    assert [len(contact.views) for contact in book.contacts] == [2, 2]


@pytest.mark.parametrize(
    ("nearer_p", "farther_p", "joined"), [(0.0002, 0.6, "farther"), (0.6, 0.0002, "nearer"), (0.5, 0.5, "nearer")]
)
def test_of_two_contacts_in_reach_a_likely_mine_is_a_view_of_the_likelier(
    nearer_p: float, farther_p: float, joined: str
) -> None:
    """The ends of a cylinder, seen as two objects on one passage; from the other side it is one."""
    book = ledger()
    book.add([view(0.0, 0.0, 100.0, p_mine=nearer_p, score=1.0), view(1.7, 0.0, 100.2, p_mine=farther_p, score=2.0)])
    book.add([view(0.4, 0.0, 900.0, p_mine=0.97, score=3.0, **SECOND_LEG)])
    assert objects_in(book.contacts) == ([{1.0}, {2.0, 3.0}] if joined == "farther" else [{1.0, 3.0}, {2.0}])


@settings(max_examples=40, deadline=None)
@given(first_p=st.floats(0.0, 1.0), second_p=st.floats(0.0, 1.0), apart_m=st.floats(0.0, 3.9))
def test_kinds_never_keep_apart_what_place_alone_would_join(first_p: float, second_p: float, apart_m: float) -> None:
    book = ledger()
    book.add([view(0.0, 0.0, 100.0, p_mine=first_p)])
    book.add([view(apart_m, 0.0, 900.0, p_mine=second_p, **SECOND_LEG)])
    assert [len(contact.views) for contact in book.contacts] == [2]


def test_views_too_far_apart_open_a_new_contact() -> None:
    config = ContactsConfig()
    far = ledger()
    far.add([view(0.0, 0.0, 100.0, sigma_m=25.0)])
    far.add([view(config.max_gate_m + 0.01, 0.0, 900.0, sigma_m=25.0, **SECOND_LEG)])
    assert len(far.contacts) == 2
    sharp = ledger()
    sharp.add([view(0.0, 0.0, 100.0, sigma_m=0.1)])
    sharp.add([view(0.1 * math.sqrt(2.0 * config.gate_chi2) + 0.01, 0.0, 900.0, sigma_m=0.1, **SECOND_LEG)])
    assert len(sharp.contacts) == 2


def test_the_gate_follows_the_shape_of_the_covariance() -> None:
    """Sure along east, unsure along north: two metres north is the same object, two metres east is another."""
    covariance = np.diag([0.05, 4.0])
    for offset, n_contacts in (((0.0, 2.0), 1), ((2.0, 0.0), 2)):
        book = ledger()
        book.add([view(0.0, 0.0, 100.0, covariance_m2=covariance)])
        book.add([view(*offset, 900.0, covariance_m2=covariance, **SECOND_LEG)])
        assert len(book.contacts) == n_contacts


def test_a_perfect_match_is_not_given_up_for_two_bad_ones() -> None:
    """One object is seen again where it was; another turns up beyond it, within the gate of the first alone."""
    book = ledger()
    book.add([view(0.0, 0.0, 100.0, score=1.0, sigma_m=0.6), view(0.0, -2.5, 101.0, score=9.0, sigma_m=0.6)])
    book.add(
        [
            view(0.0, 0.0, 900.0, score=1.0, sigma_m=0.6, **SECOND_LEG),
            view(0.0, 2.3, 902.0, score=3.0, sigma_m=0.6, **SECOND_LEG),
        ]
    )
    assert objects_in(book.contacts) == [{1.0}, {9.0}, {3.0}]


def two_views(frame: LocalFrame = HOME, p_b: float = 0.9) -> tuple[Contact, Detection, Detection]:
    a = view(0.3, -0.2, 100.0, frame=frame, covariance_m2=np.array([[1.0, 0.4], [0.4, 2.0]]), p_mine=0.9)
    covariance_m2 = np.array([[0.5, -0.2], [-0.2, 0.7]])
    b = view(-0.5, 0.6, 900.0, frame=frame, covariance_m2=covariance_m2, p_mine=p_b, **SECOND_LEG)
    book = Ledger(ALL_REPORTED)
    book.add([a])
    (contact,) = book.add([b])
    return contact, a, b


@pytest.mark.parametrize("share", [1.0, 0.5, 0.2, 0.01])
def test_the_fused_position_is_the_best_linear_estimate_and_surer_than_the_likeliest(share: float) -> None:
    """Against weighted least squares, solved as such; a view less than half as likely a mine counts in proportion."""
    contact, a, b = two_views(p_b=0.9 * share)
    assert len(contact.views) == 2
    roots = [np.linalg.inv(np.linalg.cholesky(d.covariance_m2)) for d in (a, b)]
    roots[1] *= math.sqrt(min(2.0 * share, 1.0))
    whitener = np.concatenate(roots)
    seen = np.concatenate([root @ place(d) for root, d in zip(roots, (a, b), strict=True)])
    expected, *_ = np.linalg.lstsq(whitener, seen)
    np.testing.assert_allclose(place(contact), expected, atol=1e-3)
    np.testing.assert_allclose(contact.covariance_m2, np.linalg.inv(whitener.T @ whitener), rtol=1e-3, atol=1e-4)
    for d in (a, b) if share == 1.0 else (a,):
        assert np.linalg.eigvalsh(d.covariance_m2 - contact.covariance_m2).min() > 0.0


def test_sub_apertures_of_one_passage_are_no_surer_of_the_place_than_one() -> None:
    """They share the navigation; another passage has errors of its own."""
    squints = [view(0.3 * k, 0.0, 100.0 + k, squint_rad=0.05 * k) for k in (-1, 0, 1)]
    book = Ledger(ALL_REPORTED)
    (contact,) = [book.add([one])[0] for one in squints][-1:]
    np.testing.assert_allclose(place(contact), [0.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(contact.covariance_m2, squints[0].covariance_m2, rtol=1e-3)
    (contact,) = book.add([view(0.0, 0.0, 900.0, **SECOND_LEG)])
    np.testing.assert_allclose(contact.covariance_m2, 0.5 * squints[0].covariance_m2, rtol=1e-3)


@pytest.mark.parametrize(
    "frame",
    [
        LocalFrame(latitude_deg=10.0, longitude_deg=180.0),
        LocalFrame(latitude_deg=10.0, longitude_deg=-179.999999),
        LocalFrame(latitude_deg=89.0, longitude_deg=33.0),
        LocalFrame(latitude_deg=-89.99, longitude_deg=-120.0),
        LocalFrame(latitude_deg=0.0, longitude_deg=0.0),
    ],
    ids=["antimeridian", "just east of it", "far north", "a kilometre from the south pole", "null island"],
)
def test_association_and_fusion_are_the_same_anywhere_on_earth(frame: LocalFrame) -> None:
    here, *_ = two_views()
    there, *_ = two_views(frame)
    np.testing.assert_allclose(place(there, frame), place(here), atol=1e-3)
    np.testing.assert_allclose(there.covariance_m2, here.covariance_m2, rtol=1e-9)
    assert -180.0 <= there.longitude_deg < 180.0
    book = ledger()
    book.add([view(e, 0.0, 100.0 + e, frame=frame, score=e) for e in (-3.0, -1.5, 0.0, 1.5, 3.0)])
    book.add([view(e + 0.7, 0.2, 900.0 + e, frame=frame, score=e, **SECOND_LEG) for e in (-3.0, -1.5, 0.0, 1.5, 3.0)])
    assert sorted(map(tuple, objects_in(book.contacts))) == [(-3.0,), (-1.5,), (0.0,), (1.5,), (3.0,)]


def test_sixty_views_stay_numerically_fine() -> None:
    random = np.random.default_rng(1)
    book = ledger()
    for k in range(60):
        e, n = random.normal(0.0, 0.5, 2)
        aspect = float(k * 6.0)
        book.add(
            [view(float(e), float(n), 1000.0 * k, heading_rad=math.radians(aspect), aspect_deg=aspect, p_mine=0.99)]
        )
    (contact,) = book.contacts
    assert len(contact.views) == 60
    np.testing.assert_allclose(contact.covariance_m2, np.eye(2) / 60.0, rtol=1e-3, atol=1e-9)
    assert np.hypot(*place(contact)) < 4.0 * math.sqrt(1.0 / 60.0)
    assert 0.98 < contact.p_mine < 1.0
    assert sum(contact.belief.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("sigma_m", [0.0, 1e-9, 1e4])
def test_covariances_configured_to_nothing_or_to_everything_break_nothing(sigma_m: float) -> None:
    book = ledger()
    book.add([view(0.0, 0.0, 100.0, sigma_m=sigma_m)])
    (contact,) = book.add([view(0.005, 0.0, 900.0, sigma_m=sigma_m, **SECOND_LEG)])
    assert len(contact.views) == 2
    assert np.isfinite(contact.covariance_m2).all()
    assert np.hypot(*(place(contact) - [0.0025, 0.0])) < 1e-3


def test_one_view_is_reported_as_it_is() -> None:
    only = view(3.0, 4.0, 100.0, height_m=NAN)
    (contact,) = ledger().add([only])
    assert contact.id == "C00001"
    assert (contact.latitude_deg, contact.longitude_deg) == (only.latitude_deg, only.longitude_deg)
    assert contact.p_mine == only.p_mine
    assert math.isnan(contact.height_m)
    assert contact.views == (only,)


def test_sizes_reasons_and_class_come_from_all_views() -> None:
    book = ledger()
    book.add([view(0.0, 0.0, 100.0, length_m=0.5, width_m=0.2, height_m=NAN, p_mine=0.05, reasons=("no_shadow",))])
    (contact,) = book.add(
        [view(0.0, 0.0, 900.0, length_m=1.5, width_m=0.4, height_m=0.4, score=7.0, p_mine=0.1, **SECOND_LEG)]
    )
    assert contact.length_m == 1.5
    assert contact.width_m == 0.4
    assert contact.height_m == 0.4
    assert contact.reasons == ("no_shadow", "highlight_and_shadow")
    assert contact.classification == "clutter"


def confirmed(
    log_ratio: float,
    classification: ContactClass,
    sizes: dict[str, float],
    sigma: dict[str, float],
    certainty: float = 0.9,
) -> Confirmation:
    """Make a confirmation that shows one solid, as certain as requested."""
    nowhere = drawn_looks.NOWHERE
    shape_mass = vacuous()
    shape_mass[EVERYTHING], shape_mass[subset(classification, "clutter")] = 1.0 - certainty, certainty
    model = ShapeModel(classification=classification, sizes=sizes, sigma=sigma, highlight=nowhere, shadow=nowhere)
    return drawn_looks.confirmation(log_ratio, shape_mass, model=model, reasons=("buried",))


def test_sizes_are_those_of_the_solid_in_the_view_that_shows_it_best() -> None:
    small = confirmed(2.0, "sphere", {"radius_m": 0.3, "burial_m": 0.0}, {"radius_m": 0.02})
    large = confirmed(3.0, "sphere", {"radius_m": 0.4, "burial_m": 0.1}, {"radius_m": 0.03, "burial_m": 0.08})
    other = confirmed(2.5, "cylinder", {"radius_m": 0.25, "length_m": 2.0}, {}, certainty=0.2)
    book = ledger()
    book.add([view(0.0, 0.0, 100.0, aspect_deg=0.0, p_mine=0.88, confirmation=small)])
    book.add([view(0.0, 0.0, 900.0, aspect_deg=60.0, p_mine=0.95, confirmation=large)])
    (contact,) = book.add([view(0.0, 0.0, 1700.0, aspect_deg=120.0, p_mine=0.99, confirmation=other)])
    assert contact.classification == "sphere"
    sizes = (contact.length_m, contact.width_m, contact.height_m)
    assert sizes == pytest.approx((0.8, 0.8, 0.7))
    assert (contact.length_sigma_m, contact.width_sigma_m, contact.height_sigma_m) == pytest.approx((0.06, 0.06, 0.1))
    assert contact.reasons == ("highlight_and_shadow", "buried")


def test_without_a_solid_of_the_class_sizes_are_those_measured() -> None:
    cylinder = confirmed(-5.0, "cylinder", {"radius_m": 0.25, "length_m": 2.0}, {"radius_m": 0.02, "length_m": 0.1})
    (contact,) = ledger().add([view(0.0, 0.0, 100.0, p_mine=0.01, confirmation=cylinder)])
    assert contact.classification == "clutter"
    assert (contact.length_m, contact.width_m, contact.height_m) == (0.8, 0.4, 0.3)
    assert math.isnan(contact.length_sigma_m)


def test_what_every_view_knows_of_the_rate_of_mines_counts_once_per_contact() -> None:
    """One in ten is a mine: two views that say nothing beyond that leave it there."""
    book = Ledger(ALL_REPORTED, prior=math.log(0.1 / 0.9))
    book.add([view(0.0, 0.0, 100.0, p_mine=0.1)])
    (contact,) = book.add([view(0.0, 0.0, 900.0, p_mine=0.1, **{**SECOND_LEG, "aspect_deg": 180.0})])
    assert contact.p_mine == pytest.approx(0.1)


def test_contacts_say_how_far_views_agree_and_where_to_look_next() -> None:
    book = ledger()
    (once,) = book.add([view(0.0, 0.0, 100.0, p_mine=0.6, aspect_deg=90.0)])
    assert math.isnan(once.conflict)
    assert once.next_look_deg == pytest.approx((0.0,))
    (twice,) = book.add([view(0.0, 0.0, 900.0, p_mine=0.5, aspect_deg=60.0, heading_rad=math.pi)])
    assert 0.0 <= twice.conflict < 0.6
    assert twice.next_look_deg == pytest.approx((165.0, 75.0))
    (apart,) = book.add([view(0.0, 0.0, 1700.0, p_mine=1e-5, aspect_deg=0.0)])
    assert "views_contradict" not in apart.reasons
    book.add([view(0.0, 0.0, 2500.0, p_mine=1.0 - 1e-5, aspect_deg=30.0)])
    assert "views_contradict" in book.contacts[0].reasons
    assert book.contacts[0].p_mine == 1.0 - 1e-5


def test_nothing_gives_nothing_and_what_cannot_be_a_mine_a_contact_where_all_are_reported() -> None:
    book = ledger()
    assert book.add([]) == []
    assert book.contacts == ()
    assert len(book.add([view(3.0 * k, 0.0, 100.0, p_mine=0.0) for k in range(5)])) == 5


def test_records_handed_out_before_do_not_change() -> None:
    book = ledger()
    (first,) = book.add([view(0.0, 0.0, 100.0)])
    copy = msgspec.structs.astuple(first)
    (again,) = book.add([view(0.4, 0.0, 900.0, **SECOND_LEG)])
    assert again.id == first.id
    assert again is not first
    assert msgspec.structs.astuple(first) == copy


def test_a_contact_is_reported_once_it_has_been_likely_enough_and_from_then_on() -> None:
    book = Ledger(ContactsConfig(min_p_mine=0.05))
    sphere: dict[str, Any] = {"p_mine": 0.06, "aspect_deg": 10.0, "kind_nats": (0.0, -50.0)}
    assert book.add([view(0.0, 0.0, 100.0, p_mine=0.01), view(30.0, 0.0, 100.0, **sphere)]) == list(book.contacts)
    (likely,) = book.contacts
    assert likely.p_mine == 0.06
    (risen,) = book.add([view(0.0, 0.0, 500.0, p_mine=0.5, **SECOND_LEG)])
    assert risen.p_mine >= 0.05
    assert len(risen.views) == 2  # the faint view counts as it would have if it had been reported
    (fallen,) = book.add([view(30.0, 0.0, 900.0, **{**SECOND_LEG, "p_mine": 0.06, "kind_nats": (-50.0, 0.0)})])
    assert (fallen.id, fallen.p_mine < 0.01) == (likely.id, True), "two kinds that exclude each other"
    assert [contact.id for contact in book.contacts] == sorted([risen.id, likely.id])
