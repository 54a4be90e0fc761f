"""Pages that ship with the package name only what is there."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

from auv_mcm.settings.config import parse_config
from deploy.site.pages import reference_pages
from drivers.ports import read_ports
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene_file import parse_scene

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "auv_mcm" / "docs"
MOST_WORDS = 26_000  # of all pages but the changelog
MOST_WORDS_OF_RESULTS = 3_000  # the same
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.rglob("*.md")])


@pytest.fixture(scope="module")
def made() -> set[Path]:
    """Pages that are made when the site is built; its strict build checks their anchors."""
    return {(DOCS / path).resolve() for path in reference_pages()}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_local_link_and_picture_of_a_page_exists(page: Path, made: set[Path]) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
        if not target.startswith("http") and (page.parent / target).resolve() not in made:
            assert (page.parent / target).exists(), f"{page.name} points to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_module_named_by_a_page_exists(page: Path) -> None:
    payload = ROOT / "auv_mcm"
    places = (
        ROOT,
        payload,
        payload / "waterfall",
        payload / "detect",
        ROOT / "sim_replay",
        ROOT / "sim_replay" / "simulator",
        ROOT / "sim_replay" / "augment",
    )
    for name in re.findall(r"`(?!test_)([a-z_/]+\.py)`", page.read_text()):  # tests: `test_security_page.py`
        assert any((place / name).exists() for place in places), f"{page.name} names {name}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_row_of_a_page_stands_outside_a_table(page: Path) -> None:
    for table in re.findall(r"^\|.*(?:\n\|.*)*", page.read_text(), re.MULTILINE):
        assert re.fullmatch(r"\|[-|: ]+\|", "".join(table.splitlines()[1:2])), f"{page.name}: {table}"


def test_the_readme_shows_before_it_lists_and_is_short() -> None:
    text = (ROOT / "README.md").read_text("utf-8")
    assert len(text.splitlines()) <= 60
    (film,) = re.findall(r"\((\S+\.webp)\)", text)
    assert text.index(film) < text.index("```sh") < text.index("| you have")
    data = (ROOT / film).read_bytes()
    assert data[:4] == b"RIFF"
    assert data.count(b"ANMF") > 5, "frames of an animation"
    assert len(data) <= 1_500_000


def overview_yaml(key: str) -> str:
    """The YAML block of the overview that has this key."""
    blocks = re.findall(r"```yaml\n(.*?)```", (ROOT / "auv_mcm" / "docs" / "overview.md").read_text(), re.DOTALL)
    (block,) = (block for block in blocks if f"{key}:" in block)
    return str(block)


def test_the_scene_of_the_overview_can_be_flown() -> None:
    assert len(Mission(parse_scene(overview_yaml("track"), "overview.md")).sea.objects) == 11


def test_the_ports_of_the_overview_can_be_opened() -> None:
    assert [port.name for port in read_ports(parse_config(overview_yaml("ports"), "overview.md"))] == ["sonar", "nav"]


def test_every_step_on_the_way_of_a_ping_is_in_the_code() -> None:
    text = (ROOT / "auv_mcm" / "docs" / "architecture.md").read_text()
    steps = re.findall(r"^\| (\d+) \| .* \| `([a-z_/]+)\.py` `(\w+)` \|$", text, re.MULTILINE)
    assert [int(number) for number, _, _ in steps] == list(range(1, len(steps) + 1))
    assert 10 <= len(steps) <= 15
    for _, module, name in steps:
        assert hasattr(importlib.import_module(module.replace("/", ".")), name), f"{module} has no {name}"


def words(page: Path) -> int:
    """Words that are words: no rules and no borders of tables."""
    return sum(bool(re.search(r"\w", word)) for word in page.read_text("utf-8").split())


def test_a_newcomers_questions_are_answered_by_the_page_of_the_architecture() -> None:
    section = (ROOT / "CONTRIBUTING.md").read_text("utf-8").partition("### A newcomer's ten minutes")[2]
    rooms = re.findall(r"^\| .+ \| `([a-z_/]+)` \|$", section.partition("\n## ")[0], re.MULTILINE)
    page = (DOCS / "architecture.md").read_text("utf-8")
    assert len(set(rooms)) == 12
    assert [room for room in rooms if not (ROOT / room).is_dir() or f"`{room}`" not in page] == []


def test_every_room_that_the_page_of_the_architecture_names_is_there() -> None:
    page = (DOCS / "architecture.md").read_text("utf-8")
    named = re.findall(r"`((?:auv_mcm|drivers|sim_replay)/[a-z_/]*(?:\.py)?)`", page)
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_the_docs_stay_short() -> None:
    """A page that grows takes words from another."""
    assert words(DOCS / "results.md") <= MOST_WORDS_OF_RESULTS
    assert sum(words(page) for page in PAGES if page.name != "CHANGELOG.md") <= MOST_WORDS
