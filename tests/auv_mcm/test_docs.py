"""Pages that ship with the package name only what is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene_file import parse_scene

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "auv_mcm" / "docs").glob("*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_local_link_and_picture_of_a_page_exists(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
        if not target.startswith("http"):
            assert (page.parent / target).exists(), f"{page.name} points to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_module_named_by_a_page_exists(page: Path) -> None:
    payload = ROOT / "auv_mcm"
    places = (ROOT, payload, payload / "waterfall", payload / "detect", ROOT / "sim_replay" / "simulator", ROOT / "sim_replay" / "augment")
    for name in re.findall(r"`([a-z_/]+\.py)`", page.read_text()):
        assert any((place / name).exists() for place in places), f"{page.name} names {name}"


def test_the_scene_of_the_readme_can_be_flown() -> None:
    (scene,) = re.findall(r"```yaml\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(Mission(parse_scene(scene, "README.md")).sea.objects) == 11
