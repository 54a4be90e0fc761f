"""Check files of contacts and truth: what is read, and how the rest is reported."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence, Sized
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clean_text import is_clean
from auv_mcm.contacts.export import contacts_geojson
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import NAN
from sim_replay.scoring import parse_contacts, parse_truth, read_contacts, read_truth, score_files, table
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import Lawnmower, Scene, SceneObject, Sonar, Track
from tests.auv_mcm.classify import drawn_looks
from tests.sim_replay.scoring.scoring_cases import collection, contact, truth_object, write_pair

TRUTH: dict[str, Any] = {"area_km2": 0.1, "objects": [truth_object(0.0, 0.0), truth_object(20.0, 0.0)]}


def changed(document: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """A copy with the value at a dotted path replaced, or taken away if it is `...`."""
    copy: Any = json.loads(json.dumps(document))
    *way, last = (int(key) if key.isdigit() else key for key in path.split("."))
    inner = copy
    for key in way:
        inner = inner[key]
    if value is ...:
        del inner[last]
    else:
        inner[last] = value
    found: dict[str, Any] = copy
    return found


def test_contacts_as_the_payload_writes_them_are_understood() -> None:
    written = drawn_looks.contact(
        latitude_deg=43.1,
        longitude_deg=5.9,
        covariance_m2=np.diag([0.25, 0.04]),
        p_mine=0.75,
        classification="sphere",
        belief={"sphere": 0.6, "unknown": 0.4},
        length_m=0.8,
        width_m=NAN,
        height_m=0.5,
    )
    (read,) = parse_contacts(json.loads(contacts_geojson([written])), "contacts.geojson")
    assert read[:5] == (43.1, 5.9, 0.75, "sphere", 0.8)
    assert (read.height_m, read.sigma_m) == (0.5, 0.5)
    assert np.isnan([read.width_m, read.ground_range_m]).all()


def test_truth_as_the_simulator_writes_it_is_read() -> None:
    objects = (
        SceneObject(kind="cylinder", leg=0, along_m=10.0, across_m=9.0, length_m=1.8, width_m=0.5, height_m=0.5),
        SceneObject(kind="rock", leg=0, along_m=5.0, across_m=-12.0),
    )
    track = Track(plan=Lawnmower(n_legs=1, leg_m=20.0), altitude_m=4.0)
    mission = Mission(Scene(objects=objects, sonar=Sonar(range_m=20.0, n_samples=64, beam_lines=1), track=track))
    for _ in mission.events():
        pass
    truth = parse_truth(mission.truth(), "truth")
    assert [(one.kind, one.is_target) for one in truth.objects] == [("cylinder", True), ("rock", False)]
    (look,) = truth.objects[0].looks or ()
    assert look.ground_range_m == pytest.approx(9.0, abs=0.5)
    assert truth.seabed_map is not None
    assert truth.area_km2 == pytest.approx(20.0 * 35.0e-6, rel=0.2)


def test_words_of_a_truth_file_reach_the_table_without_control_characters(tmp_path: Path) -> None:
    hostile = "mine\x1b[2J\n0.99\x9b"
    objects = [{"kind": hostile, "lat": 43.1, "lon": 5.9, "is_target": True, "seabed": hostile}]
    document = changed(
        {"type": "FeatureCollection", "features": [contact(0.0, 0.0)]}, "features.0.properties.class", hostile
    )
    (tmp_path / "truth.json").write_text(json.dumps({"area_km2": 1, "objects": objects}))
    paths = [tmp_path / name for name in ("a\x1b.geojson", "truth.json", "b\x1b.geojson", "truth.json")]
    for path in paths[::2]:
        path.write_text(json.dumps(document))
    lines = table(score_files(paths)).split("\n")
    assert [line for line in lines if not is_clean(line)] == []
    assert any(r"mine\x1b[2J\n0.99\x9b" in line for line in lines)


def test_least_that_other_producers_write_is_enough(tmp_path: Path) -> None:
    objects = [{"kind": "mine", "lat": 43.1, "lon": 5.9, "is_target": True, "colour": "green"}]
    paths = write_pair(
        tmp_path, [contact(0.0, 0.0)], {"area_km2": 1, "objects": objects, "version": 3, "scene": "x", "seed": 7}
    )
    assert score_files(paths).at_threshold.pd.value == 1.0


def test_contacts_file_without_features_is_fine(tmp_path: Path) -> None:
    score = score_files(write_pair(tmp_path, [], TRUTH))
    assert (score.at_threshold.pd.value, score.at_threshold.pd.of) == (0.0, 2)


def test_missions_pool_in_the_order_they_are_named(tmp_path: Path) -> None:
    paths = write_pair(tmp_path, [contact(0.0, 0.0)], TRUTH, "first") + write_pair(tmp_path, [], TRUTH, "second")
    score = score_files(paths)
    assert [(row.name, row.pd.count) for row in score.missions] == [(str(paths[0]), 1), (str(paths[2]), 0)]
    assert (score.at_threshold.pd.of, score.area_km2) == (4, 0.2)


def test_files_come_in_pairs_and_contacts_once(tmp_path: Path) -> None:
    contacts, truth = write_pair(tmp_path, [], TRUTH)
    for paths in ([], [contacts], [contacts, truth, contacts]):
        with pytest.raises(UsageError, match=f"^{len(paths)} file"):
            score_files(paths)
    with pytest.raises(UsageError, match=r"m\.contacts\.geojson is given twice"):
        score_files([contacts, truth, contacts, truth])


def test_swapped_files_are_reported(tmp_path: Path) -> None:
    contacts, truth = write_pair(tmp_path, [], TRUTH)
    with pytest.raises(BadInputError, match=r"m\.truth\.json: a truth file where contacts belong"):
        score_files([truth, contacts])
    with pytest.raises(BadInputError, match=r"m\.contacts\.geojson: contacts where a truth file belongs"):
        read_truth(contacts)


@pytest.mark.parametrize("read", [read_contacts, read_truth])
def test_file_that_cannot_be_read_is_named(read: Callable[[Path], object], tmp_path: Path) -> None:
    for path, message in (
        (tmp_path / "none.json", "cannot be read: No such file"),
        (tmp_path, "cannot be read: Is a directory"),
    ):
        with pytest.raises(BadInputError, match=f"{path.name} {message}"):
            read(path)


@pytest.mark.parametrize("data", [b"", b"{", b"\xff\xfe\x00", b"<xml/>", b"[" * 100_000, b'{"a":' + b"9" * 5000 + b"}"])
@pytest.mark.parametrize("read", [read_contacts, read_truth])
def test_file_that_is_no_json_is_named(read: Callable[[Path], object], data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "odd.json"
    path.write_bytes(data)
    with pytest.raises(BadInputError, match=r"odd\.json is not JSON: .*\. A (contacts|truth) file"):
        read(path)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("type", "Feature", "`type`"),
        ("features", ..., "missing required field `features`"),
        ("features.1.geometry", ..., r"missing required field `geometry` - at `features\[1\]`"),
        ("features.1.geometry.type", "Polygon", r"'Polygon' - at `features\[1\].geometry.type`"),
        ("features.1.geometry.coordinates", [5.9], r"length >= 2 - at `features\[1\].geometry.coordinates`"),
        ("features.1.geometry.coordinates", [5.9, None], r"got `null` - at `features\[1\].geometry.coordinates\[1\]`"),
        (
            "features.1.geometry.coordinates.0",
            float("nan"),
            r"features\[1\].geometry.coordinates\[0\] is not a finite number",
        ),
        (
            "features.1.geometry.coordinates",
            [5.9, 143.0],
            r"features\[1\].geometry.coordinates: \[5.9, 143\] is not a position on Earth",
        ),
        ("features.1.properties", None, r"got `null` - at `features\[1\].properties`"),
        ("features.1.properties.p_mine", ..., r"missing required field `p_mine` - at `features\[1\].properties`"),
        ("features.1.properties.p_mine", 1.01, r"`float` <= 1.0 - at `features\[1\].properties.p_mine`"),
        ("features.1.properties.p_mine", -0.01, r"`float` >= 0.0 - at `features\[1\].properties.p_mine`"),
        ("features.1.properties.length_m", 10**400, "out of range"),
        ("features.1.properties.p_mine", None, r"got `null` - at `features\[1\].properties.p_mine`"),
        ("features.1.properties.p_mine", "0.5", r"got `str` - at `features\[1\].properties.p_mine`"),
        ("features.1.properties.sigma_m", float("inf"), r"features\[1\].properties.sigma_m is not a finite number"),
    ],
)
def test_bad_contact_is_named_with_its_key(path: str, value: Any, message: str, tmp_path: Path) -> None:
    document = changed(collection([contact(0.0, 0.0), contact(1.0, 0.0)]), path, value)
    file = tmp_path / "c.geojson"
    file.write_text(json.dumps(document), "utf-8")
    with pytest.raises(BadInputError, match=rf"c\.geojson: .*{message}"):
        read_contacts(file)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("area_km2", ..., "missing required field `area_km2`"),
        ("area_km2", 0, "`float` > 0.0 - at `area_km2`"),
        ("area_km2", float("nan"), "area_km2 is not a finite number"),
        ("objects", ..., "missing required field `objects`"),
        ("objects.1.lat", ..., r"missing required field `lat` - at `objects\[1\]`"),
        ("objects.1.height_m", 10**400, "out of range"),
        ("objects.1.lat", 91, r"`float` <= 90.0 - at `objects\[1\].lat`"),
        ("objects.1.lon", float("nan"), r"objects\[1\].lon is not a finite number"),
        ("objects.1.is_target", 1, r"got `int` - at `objects\[1\].is_target`"),
        ("objects.1.kind", None, r"got `null` - at `objects\[1\].kind`"),
        ("objects.1.looks", [{}], r"missing required field `ground_range_m` - at `objects\[1\].looks\[0\]`"),
        ("seabed_map", {}, "missing required field `cell_m` - at `seabed_map`"),
        (
            "seabed_map",
            {
                "cell_m": 1,
                "latitude_deg": 0,
                "longitude_deg": 0,
                "types": ["sand"],
                "n_rows": 1,
                "n_columns": 3,
                "rows": ["2a"],
            },
            r"seabed_map.rows\[0\]: runs of 2 cells",
        ),
    ],
)
def test_bad_truth_is_named_with_its_key(path: str, value: Any, message: str, tmp_path: Path) -> None:
    file = tmp_path / "t.json"
    file.write_text(json.dumps(changed(TRUTH, path, value)), "utf-8")
    with pytest.raises(BadInputError, match=rf"t\.json: .*{message}"):
        read_truth(file)


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=5,
)
CONTACT_PATHS = (
    "type",
    "features",
    "features.0",
    *(f"features.0.{key}" for key in ("type", "geometry", "geometry.coordinates", "properties")),
)
TRUTH_PATHS = (
    "area_km2",
    "objects",
    "objects.0",
    *(f"objects.0.{key}" for key in ("kind", "lat", "looks", "height_m", "seabed")),
)


@pytest.mark.parametrize(
    ("document", "paths", "parse", "counted"),
    [
        (collection([contact(0.0, 0.0)]), CONTACT_PATHS, parse_contacts, "features"),
        (TRUTH, (*TRUTH_PATHS, "seabed_map"), lambda *words: parse_truth(*words).objects, "objects"),
    ],
)
@given(data=st.data(), value=anything)
def test_any_value_anywhere_is_understood_or_refused(
    document: Any, paths: Sequence[str], parse: Callable[[Any, str], Sized], counted: str, data: Any, value: Any
) -> None:
    document = changed(document, data.draw(st.sampled_from(paths)), value)
    try:
        n_parsed = len(parse(document, "place"))
    except BadInputError as error:
        refusal = str(error)
    else:
        assert n_parsed == len(document[counted])
        return
    assert refusal.startswith("place: ")


@pytest.mark.parametrize("document", [None, 3, [], "text", {}])
def test_document_that_is_something_else_is_refused(document: Any) -> None:
    for parse in (parse_contacts, parse_truth):
        with pytest.raises(BadInputError, match=r"^place: "):
            parse(document, "place")
