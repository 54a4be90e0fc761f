"""The site's pages that are made from the code hold all that the code has; hand-written tables agree with what is
written."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path
from typing import Any, Final

import pytest

from auv_mcm import __version__
from auv_mcm.cli import main
from auv_mcm.shell.health.record import REASONS, VALUES
from auv_mcm.shell.registry import COMMANDS
from deploy.site.pages import (
    HISTORY,
    benchmarks_page,
    commands_page,
    configuration_page,
    counters_page,
    health_page,
    notices_page,
    project_pages,
)
from deploy.site.raised import RaisedNotice, counted_names, notices_by_code, raised_notices
from sim_replay.benches.run_time.results import read_results
from sim_replay.commands.bench import BENCHES
from tests.auv_mcm.test_command_lines import SCENE

ROOT: Final = Path(__file__).parents[2]
DOCS: Final = ROOT / "auv_mcm" / "docs"


@pytest.fixture(scope="module")
def notices_found() -> dict[str, list[RaisedNotice]]:
    """Notices by code, from the sources: in the tests, for as many processes collect them as there are workers."""
    return notices_by_code(raised_notices())


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short simulated mission in `sim`, and its replay."""
    folder = tmp_path_factory.mktemp("mission")
    (folder / "scene.yaml").write_text(SCENE)
    assert main(["simulate", str(folder / "scene.yaml"), "--out", str(folder / "sim")]) == 0
    assert main(["replay", str(folder / "sim" / "mission.xtf"), "--out", str(folder / "results")]) == 0
    return folder / "results"


def test_the_site_is_built_by_the_test_command_with_warnings_as_errors() -> None:
    assert "mkdocs build --strict" in (ROOT / "deploy" / "site.sh").read_text("utf-8")
    assert "\n    sh deploy/site.sh\n" in (ROOT / "deploy" / "test.sh").read_text("utf-8")


def test_every_key_of_the_configuration_is_on_its_page(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "--write"]) == 0
    written = re.findall(r"^(\w+):|^  (\w+): ", capsys.readouterr().out, re.MULTILINE)
    page = configuration_page()
    assert len(written) > 60
    for top, inner in written:
        assert f"## {top}\n" in page or f"| `{top}` |" in page or f".{inner}` |" in page


def test_every_command_and_bench_is_on_its_page() -> None:
    page = commands_page()
    for name in (*COMMANDS, "calibrate odds", *(f"bench {name}" for name in BENCHES)):
        assert f"# auv-mcm {name}\n" in page
        assert f"usage: auv-mcm {name} " in page


def test_the_notices_page_has_each_code_with_its_text_and_no_gap_in_it(
    notices_found: dict[str, list[RaisedNotice]],
) -> None:
    page = notices_page()
    assert len(notices_found) > 90
    for code, notices in notices_found.items():
        assert f"## {code}\n" in page
        assert all(len(re.sub(r"[*…][^*…]*[*…]|\W", "", notice.text)) > 0 for notice in notices), code


def test_notices_are_read_from_the_sources_however_they_are_raised(
    notices_found: dict[str, list[RaisedNotice]],
) -> None:
    assert [notice.for_the_record for notice in notices_found["detect.cascade"]] == [True]  # by name
    assert notices_found["reader.ping_empty"][0].for_the_record is True  # through a method, by a table of codes
    assert notices_found["vehicle_control_granted"][0].for_the_record is True  # through a method, by a level of the log
    assert notices_found["vehicle_control_withheld"][0].for_the_record is False
    assert notices_found["reader.port_order"][0].for_the_record is None  # that depends on the log
    assert {"port_up", "port_down", "port_silent"} <= set(notices_found)  # with a state in the code
    assert {"survey_done", "survey_cannot", "survey_waits"} <= set(notices_found)  # from a table
    assert notices_found["nav_quantity_lost"][0].text.startswith("*quantity* is lost: '*source*' gave none for ")


def test_a_notice_whose_code_cannot_be_read_is_refused_with_its_place(tmp_path: Path) -> None:
    (tmp_path / "auv_mcm").mkdir()
    (tmp_path / "auv_mcm" / "clock.py").write_text("def f():\n    return Notice(code=made_up(), text='')\n")
    with pytest.raises(ValueError, match=r"auv_mcm/clock\.py, line 2: the code of a notice"):
        raised_notices(tmp_path)


def test_notices_and_counters_of_a_replay_are_on_their_pages(
    results: Path, notices_found: dict[str, list[RaisedNotice]]
) -> None:
    summary = json.loads((results / "summary.json").read_bytes())
    assert {notice["code"] for notice in (*summary["notices"], *summary["remarks"])} <= set(notices_found)
    names = [re.sub(r"<\w+>", r"[\\w.]+", re.escape(counted.name)) for counted in counted_names()]
    pattern = re.compile("|".join(names))
    assert [name for name in summary["counters"] if not pattern.fullmatch(name)] == []
    page = counters_page()
    assert all(f"`{counted.name}`" in page for counted in counted_names())


def table_keys(title: str, head: str = "| ") -> set[str]:
    """Read the names in the first column of a table of the page of files: the first below a title whose head begins
    so."""
    section = (DOCS / "reference" / "files.md").read_text("utf-8").partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    rows = section.partition(f"\n{head}")[2].partition("|---|")[2].partition("\n\n")[0].splitlines()[1:]
    return {name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])}


def properties(path: Path) -> set[str]:
    features: list[dict[str, Any]] = json.loads(path.read_bytes())["features"]
    assert features
    return {name for feature in features for name in feature["properties"]}


def test_the_page_of_files_names_what_a_replay_writes(results: Path) -> None:
    contacts = json.loads((results / "contacts.geojson").read_bytes())["features"]
    assert table_keys("contacts.geojson") == properties(results / "contacts.geojson")
    assert table_keys("contacts.geojson", "| property of a view |") == set(contacts[0]["properties"]["views"][0])
    assert table_keys("coverage.geojson") == properties(results / "coverage.geojson")
    assert table_keys("clearance.geojson") == properties(results / "clearance.geojson")
    assert table_keys("summary.json") == set(json.loads((results / "summary.json").read_bytes()))
    header = next(csv.reader(io.StringIO((results / "contacts.csv").read_text("utf-8"))))
    assert table_keys("contacts.csv") == set(header)


def test_the_page_of_files_names_what_a_simulation_writes(results: Path) -> None:
    truth = json.loads((results.parent / "sim" / "truth.json").read_bytes())
    assert table_keys("truth.json") == set(truth)
    assert table_keys("truth.json", "| key of an object |") == set(truth["objects"][0])


def test_every_reason_and_value_of_health_is_on_its_page() -> None:
    page = health_page()
    for name in (*REASONS, *VALUES):
        assert f"| `{name}` | " in page


def test_the_benchmark_history_has_this_version_and_every_file_of_it_can_be_compared() -> None:
    page = benchmarks_page()
    assert f"## {__version__}\n" in page
    for path in HISTORY.glob("*.json"):
        found = read_results(path)
        assert found.missions == ("flat 9600", "mixed 9600")  # others cannot be compared
        assert found.point("default") is not None
        assert f"\n| {path.stem} | {found.machine.date[:10]} | {found.machine.processor} |" in page


def test_a_version_whose_stages_were_measured_has_a_column_of_them(tmp_path: Path) -> None:
    (tmp_path / "stages").mkdir()
    assert main(["bench", "all", "--quick", "--stages", "waterfall", "--json", f"{tmp_path}/stages/0.1.0.json"]) == 0
    assert "| stage | 0.1.0 |\n| --- | --- |\n| waterfall | time " in benchmarks_page(tmp_path)


def test_links_of_project_pages_hold_in_the_site() -> None:
    for path, text in project_pages().items():
        assert "](auv_mcm/" not in text, path
