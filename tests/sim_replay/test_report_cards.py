"""The cards of contacts: why each is called what it is, drawn where it was seen, in words a person can check."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from auv_mcm.classify.beliefs import vacuous
from auv_mcm.classify.evidence import ClassEvidence, view_mass
from auv_mcm.confirm.region import HIGHLIGHT, SHADOW
from auv_mcm.records import NAN, Confirmation, Contact, ContactClass, Detection, ShapeModel, Side
from auv_mcm.snippet import pack_snippet
from sim_replay.report import PictureCollector, Shown, render_report
from sim_replay.report.panels import view_picture
from sim_replay.report.report_words import agreement, evidence_words, listed, model_sizes, plus_minus
from tests.auv_mcm.classify import drawn_looks
from tests.sim_replay.report_samples import Page, contact, detection, mission

NONE = np.empty((0, 2))
BOX = np.array([(5.0, 8.0), (5.0, 12.0), (9.0, 12.0), (9.0, 8.0)])
BEHIND = BOX + np.array([0.0, 4.0])
LIKE_A_CYLINDER: dict[ContactClass, float] = {
    "cylinder": 10.0,
    "sphere": 60.0,
    "truncated_cone": 60.0,
    "wedge": 60.0,
    "clutter": 60.0,
}


def mass(nll: Mapping[ContactClass, float], quality: float = 0.9) -> NDArray[np.float64]:
    return view_mass({name: ClassEvidence(nll=value) for name, value in nll.items()}, quality)


def confirmation(**changes: Any) -> Confirmation:
    labels = np.zeros((20, 60), dtype=np.uint8)
    labels[5:9, 8:12], labels[5:9, 12:30] = HIGHLIGHT, SHADOW
    model = ShapeModel(
        classification="cylinder",
        sizes={"radius_m": 0.26, "length_m": 1.95, "azimuth_rad": -0.3, "burial_m": 0.0},
        sigma={"radius_m": 0.03, "length_m": 0.11, "azimuth_rad": 0.06},
        highlight=BOX,
        shadow=BEHIND,
    )
    known: dict[str, Any] = {
        "log_ratio": 8.4,
        "shape_mass": mass(LIKE_A_CYLINDER),
        "mass": mass(LIKE_A_CYLINDER),
        "labels": labels,
        "highlight": BOX,
        "shadow": BEHIND,
        "model": model,
        "reasons": ("buried",),
    }
    return drawn_looks.confirmation(**{**known, **changes})


def seen(side: Side = "port", **changes: Any) -> Detection:
    return detection(side, confirmation=confirmation(**changes))


def confirmed(p_mine: float = 0.9, views: tuple[Detection, ...] | None = None, **changes: Any) -> Contact:
    given: dict[str, Any] = {
        "classification": "cylinder",
        "views": (seen(),) if views is None else views,
        "reasons": (),
    }
    return contact("C0001", p_mine, **(given | changes))


def page(*contacts: Contact) -> str:
    return render_report(Shown(mission(), contacts, [], [], [], {}, PictureCollector()))


def read(*contacts: Contact) -> str:
    return " ".join(Page(page(*contacts)).text.split())


def titles(text: str) -> list[str]:
    return re.findall(r"<figcaption>([^<]*?)\s*<", text)


def test_a_mine_like_contact_has_three_panels_and_its_picture_once() -> None:
    text = page(confirmed())
    assert titles(text) == ["As seen", "Pixels classified", "Contours and closest model"]
    assert text.count("<image ") == 1
    assert text.count('<use href="#picture-C0001"/>') == 2
    assert Page(text).ids.count("picture-C0001") == 1


def test_panels_of_parts_not_found_are_left_out() -> None:
    nothing: dict[str, Any] = {
        "labels": np.zeros((0, 0), dtype=np.uint8),
        "highlight": NONE,
        "shadow": NONE,
        "model": None,
    }
    assert titles(page(confirmed(views=(seen(**nothing),)))) == ["As seen"]
    without_model = page(confirmed(views=(seen(model=None),)))
    assert titles(without_model) == ["As seen", "Pixels classified", "Contours"]
    assert 'class="o-model"' not in without_model


def test_other_contacts_have_one_picture_with_what_was_found() -> None:
    text = page(confirmed(0.1))
    assert titles(text) == ["As seen", "Contours and closest model"]
    assert {"o-echo", "o-shadow", "o-model"} <= set(re.findall(r'class="([\w-]+)"', text))
    assert titles(page(contact("C0001", 0.1))) == ["As seen"]


def stroke(text: str, style: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (n, 2) right, down of a stroke, and width and height of its drawing."""
    drawing = next(
        part for part in re.findall(r"<svg viewBox.*?</svg>", text, re.DOTALL) if f'class="{style}" d="M' in part
    )
    size = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', drawing)
    path = re.search(rf'class="{style}" d="M([^Z]*)Z', drawing)
    assert size is not None
    assert path is not None
    points = np.array([[float(number) for number in pair.split()] for pair in path[1].split("L")])
    return points, np.array([float(size[1]), float(size[2])])


@pytest.mark.parametrize("side", ["port", "starboard"])
@pytest.mark.parametrize("row_m", [0.06, 0.12, 0.03])
@pytest.mark.parametrize("p_mine", [0.1, 0.9])
def test_a_contour_on_the_page_lies_around_the_pixel_it_encloses(side: Side, row_m: float, p_mine: float) -> None:
    intensity = np.full((20, 60), 0.05)
    intensity[4, 9] = 1000.0
    around = np.array([(4.0, 9.0), (4.0, 10.0), (5.0, 10.0), (5.0, 9.0)])
    view = msgspec.structs.replace(seen(side, highlight=around), snippet=pack_snippet(intensity), row_spacing_m=row_m)
    text = page(confirmed(p_mine, views=(view,)))
    points, size = stroke(text, "o-echo")
    (source,) = [one for one in Page(text).sources if one.startswith("data:image/jpeg")]
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(source.partition(",")[2]), dtype=np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    grey = picture.astype(np.int64).sum(axis=2)
    down, right = (np.argwhere(grey > 0.7 * grey.max()) + 0.5).mean(axis=0)
    middle = points.mean(axis=0) / size * grey.shape[::-1]
    np.testing.assert_allclose(middle, (right, down), atol=0.5)
    np.testing.assert_allclose(np.ptp(points, axis=0), (6.0, 100.0 * row_m), atol=0.11)


@settings(max_examples=40)
@given(arrays(np.uint8, (20, 60), elements=st.integers(0, 2)), st.sampled_from(["port", "starboard"]))
def test_labelled_areas_cover_the_pixels_of_their_label_and_no_others(labels: NDArray[np.uint8], side: Side) -> None:
    view = msgspec.structs.replace(seen(side, labels=labels), row_spacing_m=0.01, column_spacing_m=0.01)
    panel = next(
        (panel for panel in view_picture(view, panels=True).panels if panel.title == "Pixels classified"), None
    )
    paths = {stroke.style: stroke.path for stroke in panel.strokes} if panel else {}
    as_drawn = labels[::-1, ::-1] if side == "port" else labels[::-1]
    for style, label in (("l-echo", HIGHLIGHT), ("l-shadow", SHADOW)):
        covered = np.zeros((20, 60), dtype=np.int64)
        for corners in re.findall(r"M(\S+) (\S+)H(\S+)V(\S+)H\1Z", paths.get(style, "")):
            left, top, right, bottom = (round(float(number)) for number in corners)
            covered[min(top, bottom) : max(top, bottom), min(left, right) : max(left, right)] += 1
        np.testing.assert_array_equal(covered, as_drawn == label)


def test_a_card_says_in_words_why_it_is_called_a_mine() -> None:
    views = (seen(), detection("starboard", aspect_deg=10.0), seen(model=None, log_ratio=-0.4))
    text = read(
        confirmed(
            views=views,
            aspects_deg=(270.0, 10.0, 100.0),
            belief={"cylinder": 0.5, "sphere": 0.3, "wedge": 0.05, "unknown": 0.15},
            length_m=1.95,
            length_sigma_m=0.11,
            conflict=0.72,
            next_look_deg=(50.0, 140.0),
        )
    )
    for expected in (
        "Very likely a mine, 90 %. Cylinder about 1.9 m. Seen 3 times. Look again from 050 or 230 degrees.",
        "for: echo and shadow fit a cylinder",
        "All 3 views together cylinder 50 %sphere 30 %wedge 5 %mine, kind open 5 %unknown 10 %",
        "1.95 ± 0.11 m × 0.50 m, height unknown",
        "Views: they contradict each other: what they disagree in counts as unknown (conflict 0.72).",
        (
            "Next view: along 050° or 230°: the nearest view so far was 40° off and it is open between cylinder and "
            "sphere."
        ),
        "Evidence: strongly for a mine (+8.4 nats)",
        "Evidence: undecided (\u22120.4 nats)",
        "Best model: cylinder, length 1.95 ± 0.11 m, radius 0.26 ± 0.03 m, turned \u221217° ± 3°",
        "View 2: Not confirmed",
        "the best model lies partly buried",
        "the echo was clipped",
    ):
        assert expected in text


def test_a_card_does_not_contradict_itself() -> None:
    view = msgspec.structs.replace(
        seen(reasons=("shadow_goes_on", "weak_highlight")), p_mine=0.3, reasons=("highlight_and_shadow",)
    )
    belief = {"wedge": 0.25, "clutter": 0.6, "unknown": 0.15}
    text = read(confirmed(0.3, views=(view,), classification="wedge", belief=belief))
    assert "Possibly a mine, 30 %. Shape unclear, about 1.5 m." in text
    assert "a bright echo with a shadow" not in text, "confirmation found too little of it"


def test_a_card_says_why_it_is_not_called_a_mine() -> None:
    view = msgspec.structs.replace(
        seen(rejected=True, reasons=("shadow_goes_on", "cut_off"), log_ratio=-5.0), reasons=("highlight_and_shadow",)
    )
    text = read(confirmed(0.1, views=(view,), classification="clutter", belief={"clutter": 1.0}))
    assert "Probably not a mine: 10 % chance that it is one." in text
    assert "against: the dark goes on beside it" in text
    assert "for: a bright echo with a shadow" in text
    assert text.index("for: a bright echo") < text.index("against: the dark") < text.index("cut off by the border")
    assert "a further view would hardly change the call" in text


def test_the_front_of_a_card_speaks_no_statistics_and_names_what_the_chain_believes() -> None:
    text = page(confirmed(0.21, classification="sphere", belief={"sphere": 0.06, "clutter": 0.66, "unknown": 0.28}))
    front = text[text.index('<article class="card') : text.index('<details class="statistics">')]
    words = " ".join(Page(f"<div>{front}</article></div>").text.split())
    for word in ("nats", "p_mine", "sphere", "cylinder", "best", "0.21"):
        assert word not in words
    assert "shape unclear 21 %" in words
    assert text.count(">closest model<") == 1, "the model drawn is a cylinder, which is not what is named"
    assert "mine, kind open 15 %" in text[text.index('<details class="statistics">') :]


def test_belief_bars_fill_their_width_with_the_unknown_last() -> None:
    text = page(
        confirmed(
            views=(seen(), seen(mass=mass(LIKE_A_CYLINDER, 0.3)), seen(mass=vacuous())),
            belief={"unknown": 0.3, "wedge": 0.7},
        )
    )
    bars = re.findall(r'<div class="belief".*?</div>', text, re.DOTALL)
    assert len(bars) == 4
    for bar in bars:
        assert sum(float(width) for width in re.findall(r"width:([\d.]+)%", bar)) == pytest.approx(100.0, abs=2.1)
        names = re.findall(r'class="b-(\w+)"', bar)
        assert "unknown" not in names[:-1]
    assert re.findall(r'class="b-(\w+)"', bars[-1]) == ["open", "unknown"]


def test_of_one_view_the_belief_is_shown_once() -> None:
    shown_once = confirmed(belief={"cylinder": 1.0}, views=(seen(mass=mass(LIKE_A_CYLINDER, 0.0)),))
    assert page(shown_once).count('<div class="belief"') == 2
    assert (
        page(confirmed(0.8, belief={"unknown": 1.0}, views=(seen(mass=vacuous()),))).count('<div class="belief"') == 1
    )


def test_the_compass_shows_looks_as_arrows_towards_the_contact_and_the_next_as_a_line() -> None:
    text = page(
        confirmed(
            views=(detection(aspect_deg=0.0), detection(aspect_deg=90.0)),
            aspects_deg=(0.0, 90.0),
            next_look_deg=(45.0,),
        )
    )
    looks = [[float(n) for n in re.split("[ L]", path)] for path in re.findall(r'class="look" d="M([^M]*)M', text)]
    assert looks == [pytest.approx([0.0, 44.0, 0.0, 9.0]), pytest.approx([-44.0, 0.0, -9.0, 0.0])], (
        "from south, from west"
    )
    (line,) = re.findall(r'class="next" d="M([^"]*)"', text)
    assert [float(number) for number in re.split("[ L]", line)] == pytest.approx([-31.1, 31.1, 31.1, -31.1])
    assert "Look angles so far: 000° and 090°" in text


def test_numbers_not_known_never_show_as_nan() -> None:
    odd = msgspec.structs.replace(seen(log_ratio=NAN), aspect_deg=NAN, ground_range_m=NAN, score=NAN, time_s=NAN)
    text = page(confirmed(views=(odd, odd), aspects_deg=(NAN, NAN), next_look_deg=(10.0,), belief={}))
    markup = re.sub(r"<script>.*</script>", "", text, flags=re.DOTALL)
    without_pictures = re.sub(r"data:image/jpeg;base64,[^\"]*", "", Page(text).text + markup)
    assert "nan" not in without_pictures.lower()


def test_a_contact_whose_chance_is_not_known_stays_in_the_table() -> None:
    (row,) = re.findall('<tr class="p1"[^>]*>.*?</tr>', page(contact(p_mine=NAN)))
    assert 'data-p="0"' in row  # which the script compares with the least chance that is shown
    assert "nan" not in row


def test_very_many_views_are_listed_by_the_strongest_and_counted() -> None:
    views = tuple(
        msgspec.structs.replace(detection(), score=float(number), time_s=float(number)) for number in range(30)
    )
    text = read(confirmed(views=views, aspects_deg=(0.0,) * 30))
    assert re.findall(r"View (\d+):", text) == [str(number) for number in range(23, 31)]
    assert "and 22 weaker views" in text


def test_the_page_stays_bounded_with_every_contact_looked_at_closely() -> None:
    random = np.random.default_rng(5)
    noise = pack_snippet(random.gamma(1.0, 1.0, (100, 200)).astype(np.float32))
    speckled = random.integers(0, 3, (100, 200), dtype=np.uint8)
    view = msgspec.structs.replace(seen(labels=speckled), snippet=noise)
    many = [msgspec.structs.replace(confirmed(views=(view,)), id=f"C{number:04d}") for number in range(60)]
    text = page(*many)
    assert len(text) < 6_000_000
    assert "see snippets/C0059.png" in text


def test_words_for_numbers() -> None:
    assert [evidence_words(value) for value in (12.0, 3.0, 1.5, 0.0, -3.0, NAN)] == [
        "strongly for a mine (+12.0\u00a0nats)",
        "for a mine (+3.0\u00a0nats)",
        "slightly for a mine (+1.5\u00a0nats)",
        "undecided (+0.0\u00a0nats)",
        "against a mine (\u22123.0\u00a0nats)",
        "unknown",
    ]
    assert [agreement(value).partition(" (")[0] for value in (0.1, 0.4)] == ["they agree", "they agree in part"]
    assert "hardly show one object" in agreement(0.95)
    assert agreement(NAN) == "unknown"
    assert [plus_minus(1.0, 0.1), plus_minus(1.0, NAN), plus_minus(NAN, 0.1)] == ["1.00 ± 0.10 m", "1.00 m", "unknown"]
    assert [listed([]), listed(["a"]), listed(["a", "b", "c"])] == ["", "a", "a, b and c"]
    assert model_sizes({"height_m": 0.4, "burial_m": 0.001, "base_radius_m": NAN}, {}) == "height 0.40 m"
