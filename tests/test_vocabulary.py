"""The project's words are those of the field: coinages that the vocabulary replaces do not come back."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[1]
# Say report, raise, state or show; object, target or clutter; baseline; interface.
REPLACED: Final = re.compile(r"(?<![a-z])(tells?|told|telling|things?|rivals?|seams?)(?![a-z])", re.IGNORECASE)
TEXT: Final = (".py", ".c", ".md", ".j2", ".yaml", ".sh")
# Uses left in each part, to be lowered and never raised.
LIMITS: Final = {"auv_mcm": 5, "drivers": 6, "sim_replay": 10, "tests": 8, "README.md": 0}


def uses(part: str) -> Counter[str]:
    """Count the replaced words in a part, by file."""
    root = ROOT / part
    files = (
        [root]
        if root.is_file()
        else [path for path in sorted(root.rglob("*")) if path.suffix in TEXT and path != Path(__file__)]
    )
    return Counter({str(path.relative_to(ROOT)): len(REPLACED.findall(path.read_text("utf-8"))) for path in files})


@pytest.mark.parametrize("part", list(LIMITS))
def test_replaced_words_do_not_come_back(part: str) -> None:
    found = uses(part)
    assert found.total() <= LIMITS[part], (
        f"most in {found.most_common(5)}; see the vocabulary in auv_mcm/docs/glossary.md"
    )
