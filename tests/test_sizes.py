"""How much there is: growth is a decision, made by whoever raises a limit here and says why in the commit.

Limits are what was reached, rounded up. Aims are those of "Half the programs for the same promise".
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
TOPS: Final = ("auv_mcm", "deploy", "drivers", "sim_replay", "tests")
LANGUAGES: Final = (".py", ".c", ".h")
LONG_FUNCTION: Final = 60  # lines without decorators
LONG_FILE: Final = 500  # lines


class Limit(NamedTuple):
    """Hold the most that is allowed, and what is aimed for."""

    most: int
    aim: int


LINES: Final = {
    "auv_mcm": Limit(42_900, 35_500),
    "drivers": Limit(18_790, 15_500),
    "sim_replay": Limit(54_430, 42_000),
    "sim_replay/augment": Limit(2_230, 2_400),
    "sim_replay/batch": Limit(630, 600),
    "sim_replay/benches": Limit(7_780, 6_000),
    "sim_replay/commands": Limit(2_100, 700),
    "sim_replay/fakes": Limit(4_400, 3_500),
    "sim_replay/fitting": Limit(8_060, 5_200),
    "sim_replay/hil": Limit(2_720, 3_300),
    "sim_replay/logs": Limit(8_590, 3_900),
    "sim_replay/report": Limit(2_050, 2_000),
    "sim_replay/scoring": Limit(2_170, 2_200),
    "sim_replay/simulator": Limit(6_640, 6_900),
    "sim_replay/view": Limit(2_650, 2_000),
    "tests": Limit(84_670, 66_000),
}
LONG_FUNCTIONS: Final = Limit(5, 5)
LONG_FILES: Final = Limit(0, 0)


def sources(folder: str) -> list[Path]:
    """List the files of Python and C that are tracked or new."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", folder]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    if listed.returncode != 0:
        pytest.skip("no checkout of git, which says what is source: nothing grows in a copy")
    return [ROOT / name for name in listed.stdout.splitlines() if name.endswith(LANGUAGES) and (ROOT / name).is_file()]


def n_lines(path: Path) -> int:
    return len(path.read_bytes().splitlines())


@pytest.mark.parametrize("folder", LINES)
def test_a_package_has_no_more_lines_than_were_decided(folder: str) -> None:
    assert sum(map(n_lines, sources(folder))) <= LINES[folder].most


def long_functions(path: Path) -> Iterator[str]:
    """Go by indentation: parsing all there is takes seconds."""
    open_functions: list[tuple[int, int, str]] = []  # indentation, first line, name
    last = 0
    for number, line in enumerate([*path.read_text("utf-8").splitlines(), "end"], 1):
        text = line.lstrip()
        if not text:
            continue
        indent = len(line) - len(text)
        while open_functions and indent <= open_functions[-1][0] and not text.startswith((")", "]", "}")):
            _, first, name = open_functions.pop()
            if last - first >= LONG_FUNCTION:
                yield f"{path.relative_to(ROOT)}: {name}, {last - first + 1} lines"
        if found := re.match(r"(?:async )?def (\w+)", text):
            open_functions.append((indent, number, found[1]))
        last = number


def test_no_more_functions_are_long_than_were_decided() -> None:
    paths = [path for top in TOPS for path in sources(top) if path.suffix == ".py"]
    found = [name for path in paths for name in long_functions(path)]
    assert len(found) <= LONG_FUNCTIONS.most, "\n".join(found)


def test_no_more_files_are_long_than_were_decided() -> None:
    found = [path for top in TOPS for path in sources(top) if n_lines(path) > LONG_FILE]
    assert len(found) <= LONG_FILES.most, "\n".join(map(str, found))
