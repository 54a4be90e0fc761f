"""Draw the badges of the README, from the project's metadata and from results of its tests.

    python deploy/badges.py [--junit RESULTS.xml]

Without results the badge of the tests says that nobody filled it in. A CI of one's own runs pytest with
`--junit-xml RESULTS.xml`, draws the badges and publishes the folder: nothing is fetched, nothing is sent.
"""

from __future__ import annotations

import argparse
import tomllib
from pathlib import Path
from typing import Final
from xml.etree import ElementTree
from xml.sax.saxutils import escape

ROOT: Final = Path(__file__).parents[1]
FOLDER: Final = ROOT / "auv_mcm" / "docs" / "pictures" / "badges"
GREEN, RED, GREY, BLUE = "#2e7d4f", "#b3261e", "#6b7780", "#24515e"
_LETTER_PX: Final = 6.6  # width of a letter of 11 px, on average


def badge(name: str, value: str, colour: str) -> str:
    """Draw a badge as SVG: a name and its value."""
    left, right = (round(_LETTER_PX * len(text) + 12.0) for text in (name, value))
    texts = "".join(
        f'<text x="{at:g}" y="14" text-anchor="middle">{escape(text)}</text>'
        for at, text in ((left / 2.0, name), (left + right / 2.0, value))
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{left + right}" height="20" role="img">'
        f"<title>{escape(name)}: {escape(value)}</title>"
        f'<rect width="{left}" height="20" fill="#333"/><rect x="{left}" width="{right}" height="20" fill="{colour}"/>'
        f'<g fill="#fff" font-family="Verdana, DejaVu Sans, sans-serif" font-size="11">{texts}</g></svg>\n'
    )


def badge_of_tests(results: Path | None) -> str:
    """Draw the badge of the tests, by a JUnit file as pytest writes it."""
    if results is None:
        return badge("tests", "not filled in", GREY)
    suites = list(ElementTree.parse(results).getroot().iter("testsuite"))
    total, skipped = (sum(int(suite.get(key, 0)) for suite in suites) for key in ("tests", "skipped"))
    failed = sum(int(suite.get(key, 0)) for suite in suites for key in ("failures", "errors"))
    value = f"{failed} of {total} failed" if failed else f"{total - skipped} passed"
    return badge("tests", value, RED if failed or not total else GREEN)


def main() -> None:
    """Draw all badges."""
    parser = argparse.ArgumentParser(description="Draw the badges of the README.")
    parser.add_argument("--junit", metavar="RESULTS.xml", type=Path, help="results of pytest")
    parser.add_argument("--out", metavar="DIR", type=Path, default=FOLDER, help="folder for the badges")
    arguments = parser.parse_args()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    drawn = {
        "tests": badge_of_tests(arguments.junit),
        "version": badge("version", project["version"], BLUE),
        "python": badge("Python", project["requires-python"], BLUE),
        "licence": badge("licence", project["license"], BLUE),
    }
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name, text in drawn.items():
        (arguments.out / f"{name}.svg").write_text(text, "utf-8")


if __name__ == "__main__":
    main()
