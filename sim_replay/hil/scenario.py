"""Read scenarios strictly: what is at which wire, what goes wrong, and what is expected of the service then.

One YAML file each.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import msgspec
import yaml
from msgspec import Meta

from auv_mcm.errors import UsageError
from auv_mcm.model_file import named_files
from auv_mcm.settings.config import Config, parse_config
from auv_mcm.settings.port_settings import DEVICE_NAMES
from auv_mcm.settings.strict_yaml import explain_validation_error, load_mapping, read_text
from sim_replay.fakes.job import Device
from sim_replay.hil.known_names import is_counter, is_device_counter, is_notice, is_report
from sim_replay.hil.rules import (
    CounterRule,
    DeviceRule,
    Expectation,
    NoticeRule,
    OfDevice,
    Record,
    ReportRule,
    Restarted,
    Rule,
    SameCount,
    TargetsFound,
)

SCENARIOS: Final = Path(__file__).parent / "scenarios"
_SUFFIX: Final = ".yaml"
_DEVICE_NAME: Final = re.compile(r"[a-z][a-z0-9_]{0,31}")
_PLACEHOLDER: Final = re.compile(r"\{(.*)\}")
_ANY_LINK: Final = "tcp://127.0.0.1:9"
_SET_BY_US: Final = "output_directory"
_EXAMPLE: Final = f"{SCENARIOS / 'clean.yaml'} is an example that works"
_NEEDED: Final = {
    "about": "about: what the run shows",
    "devices": "devices: {sonar: {device: ping_protocol}}",
    "service": "service: {service: {source: ports}, ports: [{name: sonar, link: '{sonar}', device: ping_protocol}]}",
    "run_s": "run_s: 10",
    "expectations": "expectations: [{test: the service ends when requested to stop, expected: {is: exit_code}}]",
}


class HostClockStep(Record, frozen=True, kw_only=True):
    """Set UTC of the computer that the service runs on, at_s after the run's start."""

    at_s: Annotated[float, Meta(ge=0.0)]
    by_s: float


class Kill(Record, frozen=True, kw_only=True):
    """Kill the service (SIGKILL) so long after a vehicle first granted control; the run is over rest_s later."""

    after_grant_s: Annotated[float, Meta(ge=0.0)]
    rest_s: Annotated[float, Meta(gt=0.0)]


class EndsAfter(Record, frozen=True, kw_only=True):
    """End the run so long after a fake device's first report of this. containing: in its details, as JSON."""

    device: str
    what: str
    containing: str = ""
    after_s: Annotated[float, Meta(ge=0.0)]


class Scenario(Record, frozen=True, kw_only=True):
    """Define one run.

    about: what it shows. scene or log: the mission, a path beside the scenario or a shipped scene's name.

    With a vehicle's controller among the devices all of them are aboard one vehicle, which flies in the scene as
    commanded.

    speed: of the mission, times real time; faults keep their own times. run_s: maximum time until the service is
    requested to stop: it is earlier where ends_after makes it so, and where no vehicle is aboard once all devices have
    played the mission. service: its configuration; the link of a port is the name of its device in braces.
    file_limit_bytes: no file of the service, once it is ready, grows beyond it, as on a disk that is full; room for its
    results must be left. host_clock_step: what the service takes for this computer's UTC steps. kill: the service,
    while the devices go on. restarts_s: all processes of the service are killed so long after the run's start, and it
    is started again at once. power_cut_every: every so many of these are power cuts, after which files end anywhere
    behind what was synced; the mission then stands still while the service is down, however long a start takes. waits:
    the mission waits for a device that is late, and goes at real time while perception is behind or the service is
    down.
    """

    about: Annotated[str, Meta(min_length=1)]
    devices: dict[str, Device]
    service: dict[str, Any]
    run_s: Annotated[float, Meta(gt=0.0, le=86_400.0)]
    expectations: Annotated[tuple[Expectation, ...], Meta(min_length=1)]
    scene: str | None = None
    log: str | None = None
    speed: Annotated[float, Meta(gt=0.0, le=100.0)] = 1.0
    seed: Annotated[int, Meta(ge=0, le=2**31)] = 0
    stop_within_s: Annotated[float, Meta(gt=0.0, le=600.0)] = 60.0
    file_limit_bytes: Annotated[int, Meta(ge=1000)] | None = None
    host_clock_step: HostClockStep | None = None
    kill: Kill | None = None
    restarts_s: tuple[Annotated[float, Meta(ge=0.0)], ...] = ()
    power_cut_every: Annotated[int, Meta(ge=1)] | None = None
    waits: bool = False
    ends_after: EndsAfter | None = None

    @property
    def vehicle(self) -> str | None:
        """Return the name of the vehicle's controller."""
        return next((name for name, device in self.devices.items() if device.is_vehicle), None)


class Read(NamedTuple):
    """Hold a scenario and its name; folder: what its paths are relative to."""

    name: str
    folder: Path
    scenario: Scenario


def shipped() -> list[str]:
    """List the names of the scenarios that come with the package."""
    return sorted(path.stem for path in SCENARIOS.glob(f"*{_SUFFIX}"))


def read_scenario(name: str) -> Read:
    """Read a scenario from a file, or a shipped one by its name.

    Raises UsageError with the key's path for whatever is wrong with it.
    """
    path = SCENARIOS / f"{name}{_SUFFIX}" if name in shipped() else Path(name)
    if path.is_dir():
        raise UsageError(f"{path} is a folder. Give the {_SUFFIX} file of one scenario; {_EXAMPLE}")
    if path.suffix != _SUFFIX:
        raise UsageError(f"there is no scenario '{name}'. Give a {_SUFFIX} file or one of: {', '.join(shipped())}")
    scenario = parse_scenario(read_text(path, "scenario"), str(path))
    service = _with_files_from(path.parent.absolute(), scenario)
    return Read(path.stem, path.parent, msgspec.structs.replace(scenario, service=service))


def _with_files_from(folder: Path, scenario: Scenario) -> dict[str, Any]:
    """Return the service's configuration, the files that it names beginning from a folder: it is written to another."""
    named = named_files(service_config(scenario, dict.fromkeys(scenario.devices, _ANY_LINK), ""))
    service = {**scenario.service}
    for (section, key), name in named.items():
        service[section] = {**service[section], key: str(folder / name)}
    return service


def parse_scenario(text: str, place: str) -> Scenario:
    """Parse a scenario from YAML text; place names it in messages. Raises UsageError."""
    data = load_mapping(text, place, f"expected keys such as 'devices:' and 'expectations:'; {_EXAMPLE}")
    if missing := [key for key in _NEEDED if data.get(key) is None]:
        emptiness = "The file is empty. " if not data else ""
        written = "\n".join(f"  {_NEEDED[key]}" for key in missing)
        raise UsageError(
            f"{place}: {emptiness}Missing: {', '.join(missing)}. For example, write:\n{written}\n{_EXAMPLE}."
        )
    try:
        scenario = msgspec.convert(data, Scenario)
    except msgspec.ValidationError as error:
        raise UsageError(f"{place}: {explain_validation_error(error, Scenario, data)}; {_EXAMPLE}") from error
    for problem in _contradictions(scenario):
        raise UsageError(f"{place}: {problem}")
    service_config(scenario, dict.fromkeys(scenario.devices, _ANY_LINK), place)
    return scenario


def service_yaml(scenario: Scenario, uris: Mapping[str, str], results: Path) -> str:
    """Write the service's configuration, with the addresses of the devices' wires and the folder for its results."""
    filled = _filled(scenario.service, uris)
    # However busy the computer is, what was sent is to be worked off.
    patience = {"stop_within_s": scenario.stop_within_s}
    filled["service"] = {**patience, **(filled.get("service") or {}), _SET_BY_US: str(results)}
    return yaml.safe_dump(filled, sort_keys=False, allow_unicode=True)


def service_config(scenario: Scenario, uris: Mapping[str, str], place: str) -> Config:
    """Return the same, typed. Raises UsageError for a configuration that the service would refuse."""
    return parse_config(yaml.safe_dump(_filled(scenario.service, uris), sort_keys=False), f"{place}, `service`")


def _contradictions(scenario: Scenario) -> Iterator[str]:
    if (scenario.scene is None) == (scenario.log is None):
        yield "give the mission once: either `scene` or `log`"
    if not scenario.devices:
        yield "`devices` is empty: at least one is needed"
    if sum(device.is_vehicle for device in scenario.devices.values()) > 1:
        yield "`devices` has two controllers of vehicles: a run has one vehicle"
    if scenario.vehicle is not None and scenario.scene is None:
        yield f"`devices.{scenario.vehicle}` is a vehicle, which needs a world to fly in: give a `scene`"
    if scenario.vehicle is not None and scenario.speed != 1.0:
        yield (
            f"`speed` is {scenario.speed:g}, but a vehicle flies in real time: give the scene's vehicle a higher speed"
        )
    if scenario.vehicle is None and scenario.kill is not None:
        yield "`kill` waits for a grant, and `devices` has no vehicle that could give one"
    if scenario.vehicle is not None and scenario.waits:
        yield "`waits` is for recorded missions: one with a vehicle waits anyway. Leave it out"
    if scenario.kill is not None and scenario.restarts_s:
        yield "`kill` leaves the service dead, and `restarts_s` starts it again: give one of them"
    if list(scenario.restarts_s) != sorted(scenario.restarts_s):
        yield "`restarts_s` has to be in order"
    if scenario.power_cut_every is not None and not (scenario.restarts_s and scenario.waits):
        yield "`power_cut_every` needs `restarts_s`, of which some are power cuts, and `waits: true`"
    if scenario.power_cut_every is not None and scenario.host_clock_step is not None:
        yield "`power_cut_every` and `host_clock_step` each run the service in a way of their own: give one of them"
    if scenario.ends_after is not None and scenario.ends_after.device not in scenario.devices:
        yield f"`ends_after` names '{scenario.ends_after.device}', which is none of `devices`"
    if scenario.ends_after is not None and not is_report(scenario.ends_after.what):
        yield f"`ends_after` waits for a report '{scenario.ends_after.what}', which no fake device makes"
    for name in scenario.devices:
        if not _DEVICE_NAME.fullmatch(name):
            yield f"`devices.{name}`: a name has small letters, digits and underscores"
    named = set(_placeholders(scenario.service))
    if unknown := sorted(named - set(scenario.devices)):
        yield f"`service` names '{{{unknown[0]}}}', which is none of `devices`"
    if unused := sorted(set(scenario.devices) - named):
        yield f"`devices.{unused[0]}` is at no port: write link: '{{{unused[0]}}}' below `service.ports`"
    section = scenario.service.get("service")
    if isinstance(section, dict) and _SET_BY_US in section:
        yield f"`service.service.{_SET_BY_US}` is chosen for each run: leave it out"
    yield from _too_late(scenario)
    for index, expectation in enumerate(scenario.expectations):
        for problem in _not_to_be_expected(scenario, expectation.expected):
            yield f"`expectations[{index}]` {problem}"


def _too_late(scenario: Scenario) -> Iterator[str]:
    """Yield what the run is over for: what then is expected would be of a run in which nothing went wrong."""
    step = scenario.host_clock_step
    due_s = {} if step is None else {"host_clock_step": step.at_s}
    for name, device in scenario.devices.items():
        for index, fault in enumerate(device.faults):
            if fault.after == "start":
                due_s[f"devices.{name}.faults[{index}]"] = fault.at_s
    for what, at_s in due_s.items():
        if at_s >= scenario.run_s and not scenario.restarts_s:
            yield f"`{what}` is due at {at_s:g} s, when the run is over: `run_s` is {scenario.run_s:g}"
    if (every := scenario.power_cut_every) is not None and every > len(scenario.restarts_s):
        yield f"`power_cut_every` is {every}, of {len(scenario.restarts_s)} `restarts_s`: none would be a power cut"


def _not_to_be_expected(scenario: Scenario, rule: Rule) -> Iterator[str]:
    if isinstance(rule, OfDevice) and rule.device not in scenario.devices:
        yield f"names '{rule.device}', which is none of `devices`"
    if isinstance(rule, Restarted) and not scenario.restarts_s:
        yield "needs `restarts_s`"
    if isinstance(rule, TargetsFound) and scenario.scene is None:
        yield "needs the truth, which only a `scene` provides"
    if (window := getattr(rule, "between_s", None)) is not None and window[0] > window[1]:
        yield f"has a window that ends before it begins: between_s {window[0]:g} and {window[1]:g}"
    yield from _misspelt(scenario, rule)


def _misspelt(scenario: Scenario, rule: Rule) -> Iterator[str]:
    """Yield names that nothing has. A driver from a plug-in may raise and count whatever it likes."""
    ports = scenario.service.get("ports")
    ports = [port for port in ports if isinstance(port, dict)] if isinstance(ports, list) else []
    names = [str(port.get("name")) for port in ports]
    is_ours = all(port.get("device") in DEVICE_NAMES for port in ports)
    match rule:
        case NoticeRule() if is_ours and not is_notice(rule.code):
            yield f"names the notice '{rule.code}', which is never raised"
        case CounterRule() | SameCount() if is_ours and not is_counter(rule.name, names):
            yield f"names the counter '{rule.name}', which nothing counts"
        case ReportRule() if not is_report(rule.what):
            yield f"names the report '{rule.what}', which no fake device makes"
    if isinstance(rule, DeviceRule | SameCount) and not is_device_counter(rule.counter):
        yield f"names the counter '{rule.counter}', which no fake device has"


def _placeholders(value: Any) -> Iterator[str]:
    if isinstance(value, str) and (match := _PLACEHOLDER.fullmatch(value)):
        yield match[1]
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from _placeholders(inner)


def _filled(value: Any, uris: Mapping[str, str]) -> Any:
    if isinstance(value, dict):
        return {key: _filled(inner, uris) for key, inner in value.items()}
    if isinstance(value, list):
        return [_filled(inner, uris) for inner in value]
    match = _PLACEHOLDER.fullmatch(value) if isinstance(value, str) else None
    return value if match is None else uris[match[1]]
