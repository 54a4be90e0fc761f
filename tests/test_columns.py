"""Code and documents fit 120 columns; the linter holds Python to the same."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[1]
N_COLUMNS: Final = 120
PARTS: Final = ("auv_mcm", "deploy", "sim_replay", "README.md", "CONTRIBUTING.md", "CHANGELOG.md")
TEXT: Final = (".c", ".h", ".md", ".yaml", ".sh")


def lines_too_long(path: Path) -> list[str]:
    """Find the lines beyond the limit; a table's row and a command cannot be broken."""
    return [
        f"{path.relative_to(ROOT)}:{number}"
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1)
        if len(line) > N_COLUMNS and not (path.suffix == ".md" and line.lstrip().startswith(("|", "`auv-mcm")))
    ]


@pytest.mark.parametrize("part", PARTS)
def test_every_line_fits(part: str) -> None:
    paths = [path for path in sorted((ROOT / part).rglob("*")) if path.suffix in TEXT] or [ROOT / part]
    assert [line for path in paths for line in lines_too_long(path)] == []
