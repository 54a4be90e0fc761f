"""The configuration: refused with the key's path, or exactly what was written."""

from __future__ import annotations

import json
import re

import msgspec
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.clean_text import is_clean
from auv_mcm.errors import UsageError
from auv_mcm.settings.config import Config, DetectConfig, SonarConfig, config_schema, config_yaml, parse_config
from auv_mcm.settings.vehicle_settings import VehicleConfig


@pytest.mark.parametrize("text", ["", "---\n", "# nothing\n", "{}", "sonar:\n", "sonar:\n  blank_m:\ndetect:\n"])
def test_what_is_left_out_or_left_empty_keeps_its_default(text: str) -> None:
    assert parse_config(text, "f.yaml") == Config()


def test_defaults_written_out_read_back_as_defaults() -> None:
    text = config_yaml(Config())
    assert parse_config(text, "f.yaml") == Config()
    assert yaml.safe_load(text)["detect"]["p_false_alarm"] == 1e-4  # a YAML 1.1 reader sees the same number


@given(
    mission=st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]), max_size=50).filter(is_clean),
    probability=st.floats(1e-12, 0.49),
    lever=st.tuples(*[st.floats(-100.0, 100.0)] * 3),
    full_scale=st.none() | st.floats(1e-9, 1e300),
)
@settings(deadline=None, max_examples=20)
def test_any_configuration_survives_the_file(
    mission: str, probability: float, lever: tuple[float, float, float], full_scale: float | None
) -> None:
    config = Config(
        mission=mission,
        sonar=SonarConfig(lever_arm_m=lever, full_scale=full_scale),
        detect=DetectConfig(p_false_alarm=probability),
        vehicle=VehicleConfig(command=True, fence_deg=((lever[0] / 2.0, lever[1]), (probability, 5.0), (1e-5, -5.0))),
    )
    assert parse_config(config_yaml(config), "f.yaml") == config


def test_every_key_is_written_with_meaning_kind_and_default() -> None:
    text = config_yaml(Config())
    for section in msgspec.structs.fields(Config):
        for key in getattr(section.default, "__struct_fields__", (section.name,)):
            assert re.search(rf"\n *# \w.+\n *# .+; default .+\n *{key}:", text), key
    assert "number from 0 to 50; default 1.0" in text
    assert "number above 0, or empty; default empty" in text


def test_schema_lists_every_key_with_range() -> None:
    schema = json.loads(config_schema())
    blank = schema["$defs"]["SonarConfig"]["properties"]["blank_m"]
    assert (blank["minimum"], blank["maximum"], blank["default"]) == (0.0, 50.0, 1.0)
    assert schema["$defs"]["SonarConfig"]["additionalProperties"] is False


FENCE = "fence_deg: [[43, 5], [43, 6], [44, 5]]"
GNSS = "{name: gnss, link: 'udp://h:1', device: nmea0183}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sonar: {typo: 1}", "unknown field `typo` - at `sonar`"),
        ("sonar: {typo: }", "unknown field `typo`"),
        ("typo: 1", "unknown field `typo`"),
        ("sonar: {blank_m: -1}", ">= 0.0 - at `sonar.blank_m`"),
        ("sonar: {blank_m: true}", "`sonar.blank_m`"),
        ("sonar: {blank_m: 1:30}", "`sonar.blank_m`"),
        ("sonar: {lever_arm_m: [.nan, 0, 0]}", "finite number, got nan - at `sonar.lever_arm_m.0`"),
        ("sonar: {full_scale: .inf}", "finite"),
        ("sonar: {lever_arm_m: [1, 0]}", "length 3"),
        ("sonar: {transfer: guess}", "guess"),
        ("sonar: 3", "`sonar`"),
        ("plan: {max_contacts: 1.5}", "`plan.max_contacts`"),
        ("waterfall: {min_grazing_deg: 50, max_grazing_deg: 20}", "must be below"),
        (
            "vehicle: {command: true}",
            (
                "command is true without a fence: give fence_deg at least three corners [latitude, longitude] - at "
                "`vehicle`"
            ),
        ),
        ("vehicle: {fence_deg: [[43, 5], [43, 6]]}", "at least three corners"),
        ("vehicle: {fence_deg: [[43, 5], [43, 6], [99, 5]]}", "<= 90.0 - at `vehicle.fence_deg[2][0]`"),
        ("vehicle: {altitude_m: 1.0}", "must not be below min_altitude_m"),
        (
            f"vehicle: {{command: true, {FENCE}}}\nports: [{GNSS}]",
            "command is true, but no port has a vehicle's device (imc, bluefin, ",
        ),
        (
            "plan: {area_deg: [[43, 5], [43, 6]]}",
            "plan: area_deg needs at least three corners [latitude, longitude] - at `plan`",
        ),
        (
            "plan: {area_deg: [[43, 5], [43, 5.001], [43, 5.002]]}",
            "area_deg encloses no area: give its corners in order",
        ),
        (
            "plan: {area_deg: [[43, 5], [43.004, 5.004], [43, 5.004], [43.002, 5]]}",
            "give its corners in order, without crossing edges",
        ),
        ("plan: {area_deg: [[43, 5], [44, 5], [44, 6]]}", "corners more than 50 km apart"),
        ("plan: {area_deg: [[43, 5], [43.1, 5], [43.1, 5.1]]}", "more than 1000000: give a larger cell_m"),
        ("plan: {area_deg: [[43, 5], [43.001, 5], [99, 5.001]]}", "<= 90.0 - at `plan.area_deg[2][0]`"),
        ("plan: {required_clearance: 0.999}", "<= 0.99 - at `plan.required_clearance`"),
        ("plan: {max_track_m: 0}", "> 0.0 - at `plan.max_track_m`"),
        (
            f"plan: {{area_deg: [[44, 5], [44.001, 5], [44.001, 5.001]]}}\nvehicle: {{command: true, {FENCE}}}",
            "area_deg lies outside vehicle.fence_deg, where no leg can be sailed",
        ),
        (f"vehicle: {{command: true, altitude_m: 40, {FENCE}}}", "nothing at stand_off_m (12) is seen"),
        (f"sonar: {{max_range_m: 10}}\nvehicle: {{command: true, {FENCE}}}", "within sonar.max_range_m (10)"),
        (
            "ports: [{name: v, link: 'udp://h:1', device: submarine}]",
            "port 'v': device 'submarine' is unknown (valid: ping_protocol, ",
        ),
        (
            "ports: [{name: v, link: 'udp://h:1', device: imc}, {name: w, link: 'udp://h:2', device: iver}]",
            "the ports v and w are both a vehicle's",
        ),
        (
            "ports: [{name: v, link: 'serial:///a?baud=9', device: pd6}, {name: w, link: 'slcan:///a', device: pd6}]",
            "the ports v and w are both at /a, which one of them alone can open: correct one",
        ),
        ("- 1", "sections"),
        ("mission", "sections"),
        ("1: 2", "str"),
        ("mission: a\nmission: b", "'mission' is given twice"),
        ('mission: "a\\e[2Jb"', "without control characters, got 'a\\x1b[2Jb' - at `mission`"),
        ('mission: "a\\0"', "got 'a\\x00' - at `mission`"),
        ("mission: |\n  one\n  two", "one line of text without control characters, got 'one\\ntwo' - at `mission`"),
        ('mission: "\\u202e"', "got '\\u202e' - at `mission`"),
        (f'ports: [{GNSS}, {{name: "a\\tb", link: "x", device: iver}}]', "got 'a\\tb' - at `ports.1.name`"),
        ("sonar: &a {blank_m: 1}\nplan: *a", "aliases"),
        ("sonar: &a\n  x: *a", "aliases"),
        ("[", "not valid YAML"),
        ("\x00", "not valid YAML"),
        ("[" * 5000, "not valid YAML"),
        ("mission: " + "9" * 5000, "not valid YAML"),
        ("mission: !!python/object:os.system {}", "not valid YAML"),
        # a misspelt key, with the one that was meant
        ("sonar: {max_rangem: 3}", "at `sonar` (did you mean `max_range_m`?)"),
        ("detect: {max_range_m: 3}", "at `detect` (did you mean `sonar.max_range_m`?)"),
        ("plann: {cell_m: 3}", "(did you mean `plan`?)"),
        (
            "ports: [{name: a, link: x, device: imc, imc: {own_plam: true}}]",
            "at `ports[0].imc` (did you mean `own_plan`?)",
        ),
        (
            "service: {zzz: 1}",
            "known there: queue_pings, health_period_s, health_port, source, record, resume_within_h, stop_within_s, ",
        ),
        # a wrong choice, with all valid ones
        ("sonar: {transfer: guess}", "(valid: amplitude, auto, intensity, log)"),
        ("sonar: {transfer: 3}", "(valid: amplitude, auto, intensity, log)"),
        (
            "ports: [{name: a, link: x, device: pingprotocol}]",
            "(did you mean ping_protocol? valid: ping_protocol, jsf, sportscan, nmea0183, ",
        ),
        (
            "ports: [{name: a, link: x, device: pd6, navigation: {delivers: [positon]}}]",
            "(did you mean position? valid: altitude, attitude, ",
        ),
        ("ports: [{name: a, link: x, device: pd6, navigation: {heading_sign: 2}}]", "(valid: -1, 1)"),
    ],
)
def test_mistakes_are_refused_by_place_and_key_with_what_was_meant(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=re.escape(message)) as caught:
        parse_config(text, "f.yaml")
    assert str(caught.value).startswith("f.yaml: ")


@pytest.mark.parametrize("command", ["false", "true"])
def test_an_area_may_lie_across_the_antimeridian(command: str) -> None:
    area = "[[-17.0, 179.999], [-17.002, 179.999], [-17.002, -179.999], [-17.0, -179.999]]"
    fence = "[[-16.99, 179.99], [-17.01, 179.99], [-17.01, -179.99], [-16.99, -179.99]]"
    config = parse_config(f"plan: {{area_deg: {area}}}\nvehicle: {{command: {command}, fence_deg: {fence}}}", "f.yaml")
    assert parse_config(config_yaml(config), "f.yaml") == config


def test_numbers_and_words_mean_what_they_say() -> None:
    assert parse_config("detect: {p_false_alarm: 1e-4}", "f.yaml").detect.p_false_alarm == 1e-4
    assert parse_config("sonar: {blank_m: 2}", "f.yaml").sonar.blank_m == 2.0
    assert parse_config("plan: {max_contacts: 010}", "f.yaml").plan.max_contacts == 10
    for word in ("no", "2024-99-99", "off"):
        assert parse_config(f"mission: {word}", "f.yaml").mission == word


@given(st.text(max_size=60))
@settings(deadline=None)
def test_any_text_is_a_configuration_or_refused_with_its_place(text: str) -> None:
    try:
        config = parse_config(text, "f.yaml")
    except UsageError as error:
        refusal = str(error)
    else:
        assert parse_config(config_yaml(config), "f.yaml") == config
        return
    assert "f.yaml" in refusal
