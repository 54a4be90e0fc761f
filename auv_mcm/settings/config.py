"""Read one YAML file into one typed configuration, validated once, at the edge.

Unknown keys, wrong types and out-of-range values are rejected with the key's path. Every field has a default, so an
empty file is a valid configuration; `auv-mcm config --write` prints them all with their meaning.
"""

from __future__ import annotations

import json
import math
from typing import Annotated, Any, Final, Literal, TypeAlias

import msgspec
import yaml
from msgspec import Meta, inspect

from auv_mcm.clean_text import clean, is_clean
from auv_mcm.errors import UsageError
from auv_mcm.settings.budget_settings import BudgetConfig
from auv_mcm.settings.key_words import bare, key_lines
from auv_mcm.settings.plan_settings import PlanConfig, about_first
from auv_mcm.settings.port_settings import ArmLength, PortConfig, check_together, device_kind
from auv_mcm.settings.strict_yaml import explain_validation_error, load_mapping
from auv_mcm.settings.vehicle_settings import VEHICLE_NAMES, VehicleConfig

USUAL_BEAM_DEG: Final = 0.5  # degrees two-way, of sonars whose beam is not stated: usual at 400 to 900 kHz

_Choice: TypeAlias = Annotated[str, Meta(min_length=1)]  # a word that is listed, or the path of a file


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pass


class SonarConfig(_Section, frozen=True, kw_only=True):
    """Describe how the sonar stores samples and where it sits on the vehicle."""

    kind: Annotated[
        Literal["side_scan", "sas"],
        Meta(
            description="sas: synthetic aperture, with a resolution that does not depend on range; beam_width_deg does "
            "not count"
        ),
    ] = "side_scan"
    transfer: Annotated[
        Literal["auto", "amplitude", "intensity", "log"],
        Meta(
            description="what a stored number is: amplitude, intensity, or a logarithm of it; auto decides from "
            "speckle statistics"
        ),
    ] = "auto"
    db_per_count: Annotated[
        Annotated[float, Meta(ge=0.01, le=10.0)] | None,
        Meta(description="log transfer only: decibels per count; empty: estimated from speckle"),
    ] = None
    port_order: Annotated[
        Literal["auto", "near_to_far", "far_to_near"],
        Meta(description="how a log stores the port channel; auto looks for the water column"),
    ] = "auto"
    full_scale: Annotated[
        Annotated[float, Meta(gt=0.0)] | None,
        Meta(
            description="stored number at which the recorder clips; empty: found from integer samples, none for others"
        ),
    ] = None
    sound_speed_mps: Annotated[
        Annotated[float, Meta(ge=1400.0, le=1600.0)] | None,
        Meta(description="overrides the log's sound speed; empty: take it from the log, 1500 if absurd"),
    ] = None
    blank_m: Annotated[
        float, Meta(ge=0.0, le=50.0, description="ring-down: slant range ignored by bottom tracking, m")
    ] = 1.0
    max_range_m: Annotated[float, Meta(gt=0.0, le=1000.0, description="maximum range used, slant or ground, m")] = 200.0
    subsystem: Annotated[
        Literal[20, 21, 22] | None,
        Meta(
            description="which frequency of several is used, 20 low, 21 high, 22 very high; empty: the highest there is"
        ),
    ] = None
    sides: Annotated[
        Literal["as_stated", "by_number", "swapped"],
        Meta(
            description="of a log, by_number: look angles do not count; swapped: port and starboard are exchanged; of "
            "a live port ports[].sonar.sides"
        ),
    ] = "as_stated"
    beam_width_deg: Annotated[
        Annotated[float, Meta(gt=0.0, le=20.0)] | None,
        Meta(
            description="horizontal (along-track) two-way beam width, 0.7 of a one-way width, degrees; clearance "
            "promises less of a wide one; empty: 0.5"
        ),
    ] = None
    lever_arm_m: Annotated[
        tuple[ArmLength, ArmLength, ArmLength],
        Meta(description="array position from the navigation reference: forward, starboard, down, m"),
    ] = (0.0, 0.0, 0.0)
    heading_offset_deg: Annotated[
        float, Meta(ge=-180.0, le=180.0, description="array axis against vehicle heading, clockwise, degrees")
    ] = 0.0
    pitch_offset_deg: Annotated[
        float, Meta(ge=-45.0, le=45.0, description="array axis against vehicle pitch, bow up, degrees")
    ] = 0.0

    @property
    def used_beam_width_deg(self) -> float:
        """Return the beam width that is stated, or the usual one."""
        return USUAL_BEAM_DEG if self.beam_width_deg is None else self.beam_width_deg

    @property
    def beam_width_rad(self) -> float:
        """Return the angle that resolution along the track grows with range by: 0 for a synthetic aperture."""
        return 0.0 if self.kind == "sas" else math.radians(self.used_beam_width_deg)


class NavigationConfig(_Section, frozen=True, kw_only=True):
    """Set the interpolation limits and the 1-sigma errors that go into a contact's covariance."""

    max_extrapolation_s: Annotated[
        float,
        Meta(gt=0.0, le=10.0),
        Meta(
            description="a ping farther than this from navigation, and not in a hole that is bridged, is flagged "
            "stale, s"
        ),
    ] = 0.5
    max_gap_s: Annotated[
        float, Meta(gt=0.0, le=60.0, description="longest hole between two fixes bridged by interpolation, s")
    ] = 2.0
    position_sigma_m: Annotated[float, Meta(ge=0.0, le=100.0, description="1-sigma of a position fix per axis, m")] = (
        1.0
    )
    heading_sigma_deg: Annotated[
        float, Meta(ge=0.0, le=45.0, description="1-sigma of a compass, degrees; a course in its place errs more")
    ] = 1.0
    pitch_sigma_deg: Annotated[float, Meta(ge=0.0, le=45.0, description="1-sigma of pitch, degrees")] = 0.5
    sound_speed_sigma_mps: Annotated[float, Meta(ge=0.0, le=50.0, description="1-sigma of sound speed, m/s")] = 5.0
    max_speed_mps: Annotated[
        float, Meta(gt=0.0, le=30.0, description="ports only: reject fixes that imply a higher speed, m/s")
    ] = 6.0
    epsg: Annotated[
        Annotated[int, Meta(ge=1024, le=998_999)] | None,
        Meta(
            description="logs only: EPSG code of the projection in which an XTF log holds its positions in metres, "
            "such as 32632 for UTM zone 32 north; empty for degrees"
        ),
    ] = None
    recover_s: Annotated[
        float,
        Meta(ge=0.0, le=600.0, description="ports only: a better unit is used again after being healthy this long, s"),
    ] = 5.0
    surface_depth_m: Annotated[
        float, Meta(gt=0.0, le=20.0, description="ports only: reject satellite fixes deeper than this, m")
    ] = 1.0


class WaterfallConfig(_Section, frozen=True, kw_only=True):
    """Set the metric grid, and when a row or pixel earns coverage."""

    row_spacing_m: Annotated[float, Meta(ge=0.01, le=2.0, description="along-track pixel, m")] = 0.12
    column_spacing_m: Annotated[float, Meta(ge=0.005, le=2.0, description="ground-range pixel, m")] = 0.06
    tile_rows: Annotated[int, Meta(ge=64, le=8192, description="rows of a tile's core")] = 512
    max_ping_gap_m: Annotated[
        float, Meta(gt=0.0, le=10.0, description="farther apart along track, pings leave a gap without coverage, m")
    ] = 0.6
    max_turn_rate_deg_s: Annotated[
        float, Meta(gt=0.0, le=90.0, description="faster than this a row is a turn, deg/s")
    ] = 5.0
    max_spacing_ratio: Annotated[
        float,
        Meta(gt=1.0, le=10.0),
        Meta(description="pixel spacing over its straight-line value beyond which a pixel is in a turn"),
    ] = 2.0
    min_grazing_deg: Annotated[
        float, Meta(ge=0.0, le=60.0, description="minimum grazing angle of detection and coverage, degrees")
    ] = 1.0
    max_grazing_deg: Annotated[
        float,
        Meta(ge=10.0, le=90.0, description="maximum grazing angle; steeper is low resolution (near nadir), degrees"),
    ] = 70.0

    def __post_init__(self) -> None:
        if self.min_grazing_deg >= self.max_grazing_deg:
            raise ValueError(
                f"min_grazing_deg ({self.min_grazing_deg}) must be below max_grazing_deg ({self.max_grazing_deg})"
            )


class DetectConfig(_Section, frozen=True, kw_only=True):
    """Set detection: contrasts of highlight and shadow and, where a model fits the pixels, a trained cascade."""

    model: Annotated[
        _Choice,
        Meta(
            description="the trained cascade: shipped, none, or the path of a model file; one that was not trained for "
            "the pixel sizes below is not used, with a notice"
        ),
    ] = "shipped"
    seabed_model: Annotated[
        _Choice,
        Meta(
            description="what kinds of sea floor look like: shipped, or the path of a file that 'auv-mcm calibrate "
            "seabed' wrote"
        ),
    ] = "shipped"
    performance: Annotated[
        _Choice,
        Meta(
            description="how likely a mine is found where, for clearance and plans: shipped, or the path of a file "
            "that 'auv-mcm calibrate performance' wrote"
        ),
    ] = "shipped"
    gate: Annotated[
        _Choice,
        Meta(
            description="which places can become contacts and are measured: shipped, none for all, or the path of a "
            "file that 'auv-mcm calibrate gate' wrote with the odds below"
        ),
    ] = "shipped"

    p_false_alarm: Annotated[
        float,
        Meta(ge=1e-12, lt=0.5),
        Meta(
            description="tail probability of one pair of contrast boxes in pure speckle; the best of many pairs "
            "counts, so that one pixel in eighty of white speckle is above the default"
        ),
    ] = 1e-4
    max_candidates_per_tile: Annotated[
        int,
        Meta(ge=0, le=100_000),
        Meta(description="maximum number of candidates measured per tile and side, best first; the rest is counted"),
    ] = 256
    suppression_m: Annotated[float, Meta(gt=0.0, le=20.0, description="detections closer than this are one, m")] = 1.0
    max_object_m: Annotated[float, Meta(gt=0.2, le=50.0, description="maximum length of a mine, m")] = 3.5


class ConfirmConfig(_Section, frozen=True, kw_only=True):
    """Set confirmation of detections: contours, Markov field, shapes."""

    enabled: Annotated[bool, Meta(description="false: contacts carry the detector's p_mine and no class")] = True
    odds: Annotated[
        _Choice,
        Meta(
            description="what measurements say about the odds of a mine, with the background of non-mines that belongs "
            "to it: shipped, or the path of a file that 'auv-mcm calibrate odds' wrote; without --verdicts it needs a "
            "gate and a background of its own"
        ),
    ] = "shipped"
    targets: Annotated[
        _Choice,
        Meta(
            description="the mines expected, by kind and size: shipped for any, or the path of a YAML list; a mine on "
            "no line of the list keeps less of its odds"
        ),
    ] = "shipped"
    min_p_mine: Annotated[
        float,
        Meta(ge=0.0, le=1.0),
        Meta(description="threshold of p_mine, at any step, below which confirmation of a detection ends"),
    ] = 0.02
    max_per_tile: Annotated[
        int,
        Meta(ge=0, le=100_000),
        Meta(description="maximum number of detections confirmed per tile and side, best first; the rest is counted"),
    ] = 128
    max_examined_per_tile: Annotated[
        int,
        Meta(ge=0, le=100_000),
        Meta(
            description="maximum number of detections per tile and side whose outline, size and kind are measured, the "
            "likeliest by the verifier first; the others keep its p_mine, and are counted; without a verifier "
            "max_per_tile alone bounds them"
        ),
    ] = 12


class ContactsConfig(_Section, frozen=True, kw_only=True):
    """Set how detections join contacts, which contacts are reported, and which are called."""

    min_p_mine: Annotated[
        float,
        Meta(ge=0.0, le=1.0),
        Meta(
            description="p_mine below which a contact is not reported; what cannot reach it is counted and neither "
            "measured nor confirmed; 0 reports everything; above 0.02 the estimate of mines left comes out too low"
        ),
    ] = 0.02
    gate_chi2: Annotated[
        float, Meta(gt=0.0, le=100.0, description="squared Mahalanobis distance up to which two views are one object")
    ] = 9.21
    max_gate_m: Annotated[
        float, Meta(gt=0.0, le=100.0, description="never associate views farther apart than this, m")
    ] = 4.0
    false_alarms_per_km2: Annotated[
        float,
        Meta(gt=0.0, le=1e6),
        Meta(
            description="false alarms per km2 of bare sea floor that are acceptable: contacts are called mines from "
            "the likeliest down, as long as the lower end of those expected stays within it; about as many again lie "
            "on stones and other objects, and what is reported does not depend on it"
        ),
    ] = 100.0
    background: Annotated[
        _Choice,
        Meta(
            description="how densely non-mines reach each p_mine: shipped, none, or the path of a file that 'auv-mcm "
            "calibrate background' wrote with the odds configured"
        ),
    ] = "shipped"


class ServiceConfig(_Section, frozen=True, kw_only=True):
    """Set queues and pacing of the running service."""

    queue_pings: Annotated[
        int, Meta(ge=1, le=100_000, description="maximum number of pings waiting for perception")
    ] = 512
    health_period_s: Annotated[float, Meta(gt=0.0, le=3600.0, description="seconds between two health lines")] = 5.0
    health_port: Annotated[
        int,
        Meta(ge=0, le=65535),
        Meta(description="port at 127.0.0.1 for monitors of this computer: /metrics for Prometheus, /health; 0: none"),
    ] = 0
    source: Annotated[
        str, Meta(description="where pings come from: ports, or e.g. replay:///data/mission.xtf?speed=1")
    ] = ""
    record: Annotated[
        bool, Meta(description="ports only: record every byte, both ways, beside the results, to be replayed")
    ] = True
    resume_within_h: Annotated[
        float,
        Meta(ge=0.0, le=1000.0),
        Meta(
            description="ports only: hours for which a session that was cut off is gone on with at the next start; 0 "
            "begins a new one"
        ),
    ] = 12.0
    stop_within_s: Annotated[
        float,
        Meta(ge=3.0, le=600.0),
        Meta(
            description="ports only: seconds from a signal to the end; work that takes longer stays on disk, for the "
            "next start"
        ),
    ] = 5.0
    output_directory: Annotated[str, Meta(description="where contacts, coverage and the journal are written")] = (
        "auv-mcm-out"
    )


class Config(_Section, frozen=True, kw_only=True):
    """Hold the whole configuration."""

    mission: Annotated[str, Meta(max_length=200, description="name shown in reports")] = ""
    sonar: SonarConfig = SonarConfig()
    navigation: NavigationConfig = NavigationConfig()
    waterfall: WaterfallConfig = WaterfallConfig()
    detect: DetectConfig = DetectConfig()
    confirm: ConfirmConfig = ConfirmConfig()
    contacts: ContactsConfig = ContactsConfig()
    budget: BudgetConfig = BudgetConfig()
    plan: PlanConfig = PlanConfig()
    vehicle: VehicleConfig = VehicleConfig()
    service: ServiceConfig = ServiceConfig()
    ports: Annotated[tuple[PortConfig, ...], Meta(description="wires to devices, for service.source: ports")] = ()

    def __post_init__(self) -> None:
        check_together(self.ports)
        if self.vehicle.command and self.plan.area_deg and _are_apart(self.plan.area_deg, self.vehicle.fence_deg):
            raise ValueError(
                "plan: area_deg lies outside vehicle.fence_deg, where no leg can be sailed: correct one of them"
            )
        altitude_m, stand_off_m = self.vehicle.altitude_m, self.plan.stand_off_m
        near_m = altitude_m / math.tan(math.radians(self.waterfall.max_grazing_deg))
        if self.vehicle.command and not (
            near_m <= stand_off_m and math.hypot(stand_off_m, altitude_m) <= self.sonar.max_range_m
        ):
            raise ValueError(
                f"plan: nothing at stand_off_m ({stand_off_m:g}) is seen from vehicle.altitude_m ({altitude_m:g}): "
                f"give {near_m:.1f} or more, with a slant range within sonar.max_range_m ({self.sonar.max_range_m:g})"
            )
        if self.vehicle.command and self.ports and all(device_kind(port.device) != "vehicle" for port in self.ports):
            raise ValueError(
                f"vehicle: command is true, but no port has a vehicle's device ({', '.join(VEHICLE_NAMES)}): add one"
            )


def _are_apart(area_deg: tuple[tuple[float, float], ...], fence_deg: tuple[tuple[float, float], ...]) -> bool:
    """Check whether a straight line to the north or east lies between them."""
    ways = [list(zip(*about_first(corners, area_deg[0]), strict=True)) for corners in (area_deg, fence_deg)]
    return any(max(ways[0][k]) <= min(ways[1][k]) or max(ways[1][k]) <= min(ways[0][k]) for k in (0, 1))


def parse_config(text: str, place: str) -> Config:
    """Parse a configuration from YAML text; `place` names it in messages.

    An empty key or section means its default.

    Raises UsageError with the key's path for unknown and repeated keys, wrong types and out-of-range values.
    """
    data = load_mapping(text, place, f"expected sections such as 'sonar:' with indented keys. {_HELP}")
    _refuse_control_characters(data, "", place)
    _refuse_removed_keys(data, place)
    try:
        return msgspec.convert(_without_empty(data, inspect.type_info(Config)), Config)
    except msgspec.ValidationError as error:
        raise UsageError(f"{place}: {explain_validation_error(error, Config)}. {_HELP}") from error


def _refuse_removed_keys(data: Any, place: str) -> None:
    """Raise UsageError for a key of former versions, naming what took its place."""
    for (section, key), instead in _REMOVED.items():
        if isinstance(data.get(section), dict) and key in data[section]:
            raise UsageError(f"{place}: {section}.{key} is gone: {instead}. Remove the key. {_HELP}")


_REMOVED: Final = {
    ("detect", "max_evaluations_per_tile"): "budget.duty now bounds all work on a tile together, and 'auv-mcm "
    "calibrate budget' measures what this computer affords"
}


def config_yaml(config: Config) -> str:
    """Write `config` as YAML text that parse_config reads back.

    Each key is preceded by its meaning, range and default.
    """
    lines = [
        "# Configuration of auv-mcm. Every key may be left out; its default then holds.",
        "# 'auv-mcm check --config FILE' checks a file. Files that it names are looked for from its own folder.",
        "",
    ]
    root = inspect.type_info(Config)
    assert isinstance(root, inspect.StructType)
    for field in root.fields:
        section = getattr(config, field.name)
        if section and isinstance(section, tuple):
            text = yaml.safe_dump(
                {field.name: msgspec.to_builtins(section)}, sort_keys=False, allow_unicode=True, width=math.inf
            )
            lines += [*key_lines(field, (), "")[:-1], *text.splitlines(), ""]
            continue
        if not isinstance(field.type, inspect.StructType):
            lines += [*key_lines(field, section, ""), ""]
            continue
        lines += [f"# {(field.type.cls.__doc__ or '').strip()}", f"{field.name}:"]
        for inner in field.type.fields:
            lines += key_lines(inner, getattr(section, inner.name), "  ")
        lines.append("")
    return "\n".join(lines[:-1]) + "\n"


def config_schema() -> str:
    """Give the JSON Schema (draft 2020-12) of the configuration, for editors and scripts."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **msgspec.json.schema(Config)}
    return json.dumps(schema, indent=2) + "\n"


_HELP = "'auv-mcm config --write' prints every key with its meaning and range"


def _without_empty(data: Any, kind: inspect.Type) -> Any:
    """Remove known keys that have no value, at any depth."""
    kind = bare(kind)
    if isinstance(kind, inspect.StructType) and isinstance(data, dict):
        kinds = {field.name: field.type for field in kind.fields}
        cleaned = {key: _without_empty(value, kinds.get(key, kind)) for key, value in data.items()}
        return {key: value for key, value in cleaned.items() if value is not None or key not in kinds}
    if isinstance(kind, inspect.VarTupleType) and isinstance(data, list):
        return [_without_empty(item, kind.item_type) for item in data]
    return data


def _refuse_control_characters(data: Any, path: str, place: str) -> None:
    if isinstance(data, str) and not is_clean(data):
        raise UsageError(
            f"{place}: Expected one line of text without control characters, got '{clean(data)}' - at `{path}`. Write "
            "it anew"
        )
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        _refuse_control_characters(value, f"{path}.{key}" if path else str(key), place)
