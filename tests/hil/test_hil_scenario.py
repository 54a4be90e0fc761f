"""Scenarios are read to the last key, and what cannot be is refused before anything is started."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from auv_mcm.cli import main
from auv_mcm.commands import read_config
from auv_mcm.errors import UsageError
from auv_mcm.settings.config import parse_config
from deploy.site.raised import counted_names, notices_by_code, raised_notices
from drivers.ports import read_ports
from sim_replay.hil.evidence import Report
from sim_replay.hil.known_names import is_counter
from sim_replay.hil.scenario import (
    SCENARIOS,
    Read,
    parse_scenario,
    read_scenario,
    service_config,
    service_yaml,
    shipped,
)
from sim_replay.hil.undone import undone
from sim_replay.hil.verdict import Evidence
from tests.hil.test_hil_runs import run

SOUND = """
about: what it shows
scene: demo
run_s: 5
devices:
  sonar: {device: ping_protocol}
  nav: {device: pd6, faults: [{do: stall, at_s: 1, for_s: 2}]}
service:
  service: {source: ports}
  ports:
    - {name: sonar, link: '{sonar}', device: ping_protocol}
    - {name: other, link: '{nav}', device: pd6}
expectations:
  - {test: it ends, expected: {is: exit_code}}
  - {test: it pings, expected: {is: summary, key: pings, at_least: 10}}
"""
URIS = {"sonar": "serial:///ports/sonar?baud=115200", "nav": "serial:///ports/nav?baud=9600"}


def test_the_service_gets_the_devices_addresses_and_a_folder_for_its_results(tmp_path: Path) -> None:
    scenario = parse_scenario(SOUND, "here")
    config = parse_config(service_yaml(scenario, URIS, tmp_path / "results"), "service.yaml")
    assert [(port.name, port.link) for port in config.ports] == [("sonar", URIS["sonar"]), ("other", URIS["nav"])]
    assert (config.service.source, config.service.output_directory) == ("ports", str(tmp_path / "results"))


def test_files_that_the_configuration_names_are_looked_for_from_the_scenarios_folder(tmp_path: Path) -> None:
    files = "  confirm: {targets: mines.yaml, odds: /models/odds.json}\n  detect: {model: none}\n"
    (tmp_path / "own.yaml").write_text(SOUND.replace("service:\n", f"service:\n{files}", 1))
    out = tmp_path / "out" / "service.yaml"
    out.parent.mkdir()
    out.write_text(service_yaml(read_scenario(str(tmp_path / "own.yaml")).scenario, URIS, tmp_path / "results"))
    config = read_config(out)
    assert config.confirm.targets == str(tmp_path / "mines.yaml")
    assert (config.confirm.odds, config.detect.model) == ("/models/odds.json", "none")


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("run_s: 5", "run_s: 5\nrun_for: 6", "run_for"),
        ("run_s: 5", "run_s: 0", "run_s"),
        ("run_s: 5", "run_s: 5\nkill: {after_grant_s: 1, rest_s: 1}", "no vehicle"),
        ("scene: demo", "scene: demo\nlog: a.xtf", "either `scene` or `log`"),
        ("scene: demo\n", "", "either `scene` or `log`"),
        ("link: '{nav}'", "link: '{gps}'", r"'\{gps\}', which is none of `devices`"),
        ("link: '{nav}'", "link: 'tcp://1.2.3.4:5'", "`devices.nav` is at no port"),
        ("device: pd6}", "device: pd7}", "pd7"),
        ("source: ports", "source: ports, output_directory: x", "output_directory"),
        ("source: ports", "source: ports, queue_pings: 0", "queue_pings"),
        ("  nav:", "  Nav:", "devices.Nav"),
        (", at_least: 10", "", "neither at_least nor at_most"),
        ("{is: exit_code}", "{is: reopened, device: gps, within_s: 1}", "names 'gps'"),
        ("{is: exit_code}", "{is: line, matching: '(', at_least: 1}", "not a regular expression"),
        ("for_s: 2", "for_s: 2, rates: {}", "rates"),
        ("at_s: 1,", "at_s: 5,", r"`devices\.nav\.faults\[0\]` is due at 5 s, when the run is over"),
        ("run_s: 5", "run_s: 5\nends_after: {device: nav, what: dnoe, after_s: 1}", "waits for a report 'dnoe'"),
        ("run_s: 5", "run_s: 5\nhost_clock_step: {at_s: 6, by_s: 1}", "`host_clock_step` is due at 6 s"),
        ("run_s: 5", "run_s: 5\nwaits: true\nrestarts_s: [1]\npower_cut_every: 2", "none would be a power cut"),
        ("do: stall, at_s: 1, for_s: 2", "do: damage, at_s: 1, rates: {}", "'damage' changes nothing"),
        ("do: stall, at_s: 1, for_s: 2", "do: damage, at_s: 1, rates: {delay: 0.5}", "'damage' changes nothing"),
        ("do: stall, at_s: 1, for_s: 2", "do: wrong_baud, at_s: 1, baud: 115200", "'wrong_baud' changes nothing"),
        ("do: stall, at_s: 1, for_s: 2", "do: offset, at_s: 1", "changes nothing"),
        ("do: stall, at_s: 1, for_s: 2", "do: clock_step, at_s: 1, by_s: 0", "'clock_step' changes nothing"),
    ],
)
def test_what_cannot_be_is_refused_with_its_place(old: str, new: str, named: str) -> None:
    assert old in SOUND
    with pytest.raises(UsageError, match=named) as refusal:
        parse_scenario(SOUND.replace(old, new, 1), "my.yaml")
    assert "my.yaml" in str(refusal.value)


@pytest.mark.parametrize(
    ("rule", "named"),
    [
        ("{is: notice, code: port_dwon, at_most: 0}", "the notice 'port_dwon', which is never raised"),
        ("{is: counter, name: navigation.ping_stael, at_most: 0}", "which nothing counts"),
        ("{is: counter, name: 'port.sonra.*refused*', at_most: 0}", "which nothing counts"),
        ("{is: device, device: nav, counter: device.skiped, at_most: 0}", "which no fake device has"),
        ("{is: same_count, device: nav, name: pnig.gap, counter: device.events}", "which nothing counts"),
        ("{is: reported, device: nav, what: reopend, at_most: 0}", "which no fake device makes"),
        ("{is: notice, code: port_down, at_most: 0, between_s: [3, 1]}", "ends before it begins"),
        ("{is: notice, code: port_down, at_least: 0}", "met by any count"),
        ("{is: counter, name: ping.gap, at_least: 3, at_most: 2}", "no number is at least 3 and at most 2"),
    ],
)
def test_an_expectation_that_holds_whatever_happens_is_refused(rule: str, named: str) -> None:
    with pytest.raises(UsageError, match=re.escape(named)):
        parse_scenario(SOUND.replace("{is: exit_code}", rule), "my.yaml")


@pytest.mark.parametrize("code", sorted(notices_by_code(raised_notices())))
def test_every_notice_that_is_raised_can_be_expected(code: str) -> None:
    assert parse_scenario(SOUND.replace("{is: exit_code}", f"{{is: notice, code: {code}, at_most: 0}}"), "here")


def test_every_counter_can_be_expected() -> None:
    names = {re.sub("<[^>]*>", "*", counted.name) for counted in counted_names()}
    assert names
    assert [name for name in sorted(names) if not is_counter(name, [])] == []


def test_without_sources_every_name_passes_and_a_warning_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    for name in ("_ALL", "_FAKES"):  # as in an installation of compiled files alone
        monkeypatch.setattr(f"sim_replay.hil.known_names.{name}", (tmp_path,))
    rules = (
        "notice, code: port_dwon",
        "counter, name: pnig.gap",
        "device, device: nav, counter: x",
        "reported, device: nav, what: x",
    )
    for rule in rules:
        assert parse_scenario(SOUND.replace("{is: exit_code}", f"{{is: {rule}, at_most: 0}}"), "here")
    assert ["no sources" in message for message in caplog.messages] == [True]


def test_what_a_driver_of_a_plug_in_raises_and_counts_is_its_own_affair(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim_replay.hil.scenario.DEVICE_NAMES", ("ping_protocol",))  # as if pd6 came from elsewhere
    for rule in ("{is: notice, code: acme_tilted, at_most: 0}", "{is: counter, name: acme.tilts, at_most: 0}"):
        assert parse_scenario(SOUND.replace("{is: exit_code}", rule), "here")


STALLED = {"sonar": [], "nav": [Report(1.0, "fault", {"do": "stall"})]}
DONE, FREEZE = Report(1.0, "done", {}), Report(1.0, "fault", {"do": "freeze"})
FROZEN = "freeze"  # in place of a stall
STEPS = "host_clock_step: {at_s: 4, by_s: 1}"


@pytest.mark.parametrize(
    ("changed", "ran", "words"),
    [
        ("", (STALLED, [], 0, 5.0), []),
        ("", ({"sonar": [], "nav": []}, [], 0, 5.0), ["1 of 1 faults 'stall' of 'nav' did not begin"]),
        ("", ({**STALLED, "nav": [DONE, *STALLED["nav"]]}, [], 0, 5.0), []),
        (FROZEN, ({"sonar": [], "nav": [FREEZE, DONE]}, [], 0, 5.0), []),
        (
            FROZEN,
            ({"sonar": [], "nav": [DONE, FREEZE._replace(at_s=1.1)]}, [], 0, 5.0),
            ["1 of 1 faults 'freeze' of 'nav' did not begin before its last message"],
        ),
        ("", (STALLED, ["fake device 'nav'"], 0, 5.0), ["fake device 'nav' ended on the way"]),
        ("restarts_s: [1]", (STALLED, [], 0, 5.0), ["the service was started again 0 of 1 times"]),
        ("restarts_s: [1]", (STALLED, [], 1, 5.0), []),
        (STEPS, (STALLED, [], 0, 5.0), []),
        (STEPS, (STALLED, [], 0, 3.0), ["the host's clock did not step: the service had ended after 3.0 s"]),
    ],
)
def test_what_a_run_did_not_do_of_its_scenario_is_listed(changed: str, ran: Any, words: list[str]) -> None:
    text = SOUND.replace("do: stall", "do: freeze") if changed == FROZEN else f"{SOUND}\n{changed}\n"
    assert list(undone(parse_scenario(text, "here"), *ran)) == words


def test_targets_cannot_be_expected_of_a_log() -> None:
    rule = "{is: targets_found, within_m: 1, min_p_mine: 0, at_least: 1}"
    with pytest.raises(UsageError, match="needs the truth"):
        parse_scenario(SOUND.replace("scene: demo", "log: a.xtf").replace("{is: exit_code}", rule), "here")


def test_a_name_that_is_neither_shipped_nor_a_file_is_answered_with_those_that_are() -> None:
    with pytest.raises(UsageError, match="clean"):
        read_scenario("cleam")
    with pytest.raises(UsageError, match=r"nowhere\.yaml"):
        read_scenario("nowhere.yaml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty. Missing: about, devices, service, run_s, expectations. For example, write"),
        ("# later\n", "about: what the run shows"),
        (SOUND.replace("about: what it shows", "about:"), "Missing: about. For example, write"),
        (SOUND.replace("run_s: 5", ""), "  run_s: 10\n"),
        ("- about\n", "got list; expected keys such as 'devices:'"),
        (SOUND.replace("{device: ping_protocol}", "{link: serial}"), "missing required field `device` - at `devices"),
    ],
)
def test_missing_keys_are_reported_with_the_file_the_key_and_what_to_write(
    tmp_path: Path, text: str, words: str
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text, "utf-8")
    with pytest.raises(UsageError) as refusal:
        read_scenario(str(path))
    assert str(refusal.value).startswith(f"{path}: ")
    assert words in str(refusal.value)
    assert str(SCENARIOS / "clean.yaml") in str(refusal.value)


def test_the_suggested_keys_make_a_scenario(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("scene: demo", "utf-8")
    with pytest.raises(UsageError) as refusal:
        read_scenario(str(path))
    written_lines = [line for line in str(refusal.value).splitlines() if line.startswith("  ")]
    assert parse_scenario("\n".join(["scene: demo", *(line.strip() for line in written_lines)]), "here").run_s == 10.0


@pytest.mark.parametrize("name", ["folder", "folder.yaml"])
def test_a_folder_is_no_scenario(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(UsageError, match=r"is a folder\. Give the \.yaml file"):
        read_scenario(str(tmp_path / name))


@pytest.mark.parametrize("name", shipped())
def test_shipped_scenarios_are_sound_short_and_state_their_expectations(name: str) -> None:
    read = read_scenario(name)
    scenario = read.scenario
    assert scenario.run_s <= (40.0 if scenario.vehicle is None else 150.0)
    assert read.scenario.scene is not None
    assert (read.folder / read.scenario.scene).is_file()
    ends = yaml.safe_load((SCENARIOS / f"{name}.yaml").read_text("utf-8"))["expectations"][0]["expected"]
    assert ends == ({"is": "exit_code"} if scenario.kill is None else {"is": "exit_code", "code": -9})
    links = {
        "serial": "serial:///dev/{name}?baud=9600",
        "slcan": "slcan:///dev/{name}?bitrate=250000",
        "tcp": "tcp://a:1",
        "udp": "udp://a:1",
    }
    uris = {device: links[device_job.link].format(name=device) for device, device_job in scenario.devices.items()}
    assert len(read_ports(service_config(scenario, uris, name))) == len(scenario.devices)


def test_the_command_lists_scenarios_and_wants_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--list") == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == shipped()
    with pytest.raises(UsageError, match="--list"):
        run()


FLOWN = """
about: what it shows
scene: demo
run_s: 5
devices:
  sonar: {device: ping_protocol}
  vehicle: {device: imc, link: udp, faults: [{do: revoke, at_s: 1, after: grant}]}
service:
  service: {source: ports}
  ports:
    - {name: sonar, link: '{sonar}', device: ping_protocol}
    - {name: vehicle, link: '{vehicle}', device: imc}
expectations:
  - {test: it ends, expected: {is: exit_code}}
  - {test: it is reported, expected: {is: told_in_time, device: vehicle, within_s: 1, min_p_mine: 0.2}}
"""


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("scene: demo", "log: a.xtf", "needs a world"),
        ("run_s: 5", "run_s: 5\nspeed: 2", "real time"),
        ("{device: ping_protocol}", "{device: iver}", "two controllers"),
        ("told_in_time, device: vehicle", "told_in_time, device: boat", "'boat'"),
        ("do: revoke", "do: freeze", "not a navigation unit"),
    ],
)
def test_a_vehicle_that_cannot_fly_is_refused(old: str, new: str, named: str) -> None:
    assert old in FLOWN
    with pytest.raises(UsageError, match=named):
        parse_scenario(FLOWN.replace(old, new, 1), "my.yaml")


@pytest.mark.parametrize(
    ("right", "wrong", "hint"),
    [
        ("is: exit_code", "is: exitcode", "(did you mean exit_code? valid: counter, summary, notice, "),
        ("at_least: 148", "atleast: 148", "(did you mean `at_least`?)"),
        ("link: serial,", "link: seriel,", "(did you mean serial? valid: serial, slcan, tcp, udp)"),
        (
            "baud: 921600}",
            "baud: 921600, faults: [{do: unplgu, at_s: 3}]}",
            "(did you mean unplug? valid: unplug, power_off, ",
        ),
    ],
)
def test_a_mistake_in_a_scenario_is_refused_with_what_was_meant(right: str, wrong: str, hint: str) -> None:
    text = (SCENARIOS / "clean.yaml").read_text()
    assert right in text
    with pytest.raises(UsageError, match=re.escape(hint)):
        parse_scenario(text.replace(right, wrong), "f.yaml")


def test_all_runs_every_shipped_scenario_and_fails_if_one_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = []

    def run_nothing(read: Read, folder: Path, progress: Callable[[str], None]) -> Evidence:
        assert folder.is_dir()
        ran.append(read.name)
        reports: dict[str, list[Report]] = {name: [] for name in read.scenario.devices}
        return Evidence(exit_code=None, lines=[], reports=reports, summary={}, contacts=(), targets=(), replayed=None)

    monkeypatch.setattr("sim_replay.hil.run.run_scenario", run_nothing)
    assert main(["hil", "--all", "--out", str(tmp_path)]) == 5
    assert ran == shipped()
    assert main(["hil", "--all", "clean"]) == 2
