"""Pages that ship with the package name only what is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "auv_mcm" / "docs").glob("*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_local_link_and_picture_of_a_page_exists(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
        if not target.startswith("http"):
            assert (page.parent / target).exists(), f"{page.name} points to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_module_named_by_a_page_exists(page: Path) -> None:
    places = (ROOT, ROOT / "auv_mcm", ROOT / "auv_mcm" / "waterfall", ROOT / "auv_mcm" / "detect")
    for name in re.findall(r"`([a-z_/]+\.py)`", page.read_text()):
        assert any((place / name).exists() for place in places), f"{page.name} names {name}"
