"""Example configurations are valid by the strict reader, and files for udev and networkd have the form those read."""

from __future__ import annotations

import re
from configparser import RawConfigParser
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from auv_mcm import __version__
from auv_mcm.cli import main
from auv_mcm.commands import read_config
from auv_mcm.shell.registry import COMMANDS, SOURCES
from auv_mcm.shell.sources import parse_source_uri
from deploy.badges import FOLDER, GREEN, RED, badge_of_tests
from drivers.ports import read_ports
from sim_replay.hil.scenario import shipped

DEPLOY = Path(__file__).parents[2] / "deploy"
EXAMPLES = sorted((DEPLOY / "examples").iterdir())
RULES = DEPLOY / "udev" / "99-auv-mcm.rules"
RULE = re.compile(r'[A-Z]+(\{\w+\})?(==|!=|=|\+=)"[^"]*"(, [A-Z]+(\{\w+\})?(==|!=|=|\+=)"[^"]*")*')


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_an_example_is_valid_and_its_ports_are_what_drivers_speak(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = read_config(path)
    assert parse_source_uri(config.service.source).scheme in SOURCES
    ports = read_ports(config) if config.ports else []
    assert (config.service.source == "ports") == bool(ports), "a source without ports, or ports without a source"
    assert main(["run", "--interface", "--config", str(path)]) == 0
    described = capsys.readouterr().out
    assert [port.name for port in ports if port.name not in described] == []
    assert config.service.output_directory.startswith("/var/lib/auv-mcm/"), "where the unit may write"
    assert not config.vehicle.command, "an example that is run as it stands must not ask for a vehicle"


@pytest.mark.parametrize("name", ["github-hil.yml", "self-hosted-hil.yml"])
def test_the_template_for_a_ci_runs_commands_and_scenarios_that_are_there(name: str) -> None:
    jobs = yaml.safe_load((DEPLOY / "ci" / name).read_text())["jobs"]
    runs = [step["run"].removeprefix(".venv/bin/").split() for step in jobs["hil"]["steps"] if "run" in step]
    hil = next(words for words in runs if words[:2] == ["auv-mcm", "hil"])
    assert set(hil[2 : hil.index("--out")]) <= {"--all", *shipped()}
    assert all(words[0] != "auv-mcm" or words[1] in COMMANDS for words in runs)


def test_badges_show_what_the_tests_came_to(tmp_path: Path) -> None:
    """What a badge says, its title has; the colour is red where a test failed."""
    for attributes, says, colour in (
        ('tests="9" failures="0" errors="0" skipped="2"', "tests: 7 passed", GREEN),
        ('tests="9" failures="1" errors="1" skipped="0"', "tests: 2 of 9 failed", RED),
    ):
        (tmp_path / "r.xml").write_text(f"<testsuites><testsuite {attributes}/></testsuites>")
        drawn = ElementTree.fromstring(badge_of_tests(tmp_path / "r.xml"))
        assert drawn.findtext("{*}title") == says
        assert colour in ElementTree.tostring(drawn, encoding="unicode")
    assert {path.stem for path in FOLDER.glob("*.svg")} == {"tests", "version", "python", "licence"}
    assert __version__ in (FOLDER / "version.svg").read_text()


def test_every_vehicle_dialect_and_sonar_has_an_example() -> None:
    devices = {port.device for path in EXAMPLES for port in read_config(path).ports}
    assert devices >= {"imc", "bluefin", "iver", "recon", "vehicle_can", "ping_protocol", "jsf", "sportscan"}
    assert devices >= {"nmea0183", "nmea2000", "pixse", "water_linked"}


def test_rules_of_udev_have_their_form_those_to_be_filled_in_as_well() -> None:
    lines = [
        line.removeprefix("#") for line in RULES.read_text().splitlines() if line.startswith(("SUB", "ACT", "#SUB"))
    ]
    assert len(lines) == len([line for line in RULES.read_text().splitlines() if line and not line.startswith("# ")])
    assert [line for line in lines if RULE.fullmatch(line) is None] == []


def test_names_of_ports_in_the_examples_are_those_that_the_rules_give() -> None:
    given = set(re.findall(r'SYMLINK\+="([^"]+)"', RULES.read_text()))
    used = {name for path in EXAMPLES for name in re.findall(r"serial:///dev/([^?]+)", path.read_text())}
    assert used == given


def test_the_container_file_copies_what_the_wheel_is_built_from() -> None:
    steps = (DEPLOY / "Containerfile").read_text().splitlines()
    copied = {name for step in steps if step.startswith("COPY ") for name in step.split()[1:-1]}
    (built_from,) = re.findall(r'cp -R (pyproject.*) "\$work/\$build-source"', (DEPLOY / "wheelhouse.sh").read_text())
    assert copied == set(built_from.split())
    assert not [name for name in copied if not (DEPLOY.parent / name).exists()]


@pytest.mark.parametrize("name", ["80-auv-mcm-can.network", "80-auv-mcm-can.link"])
def test_files_of_networkd_match_can_interfaces(name: str) -> None:
    file = RawConfigParser()
    file.read(DEPLOY / "can" / name)
    assert file["Match"]["Type"] == "can"
