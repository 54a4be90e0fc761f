"""Install packages with entry points into a folder on the module search path, as pip would, without a network."""

from __future__ import annotations

import shutil
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final
from unittest import mock

EXAMPLE: Final = Path(__file__).parent / "example_package"


def write_package(
    folder: Path, name: str, entry_points: dict[str, dict[str, str]], modules: dict[str, str] | None = None
) -> None:
    """Write the metadata by which Python finds an installed package. modules: source texts by module name."""
    info = folder / f"{name.replace('-', '_')}-1.2.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
    lines = [
        line
        for group, names in entry_points.items()
        for line in (f"[{group}]", *(f"{key} = {names[key]}" for key in names))
    ]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    for module, text in (modules or {}).items():
        (folder / f"{module}.py").write_text(text)


def install_example(folder: Path) -> None:
    """Install the example package as its pyproject.toml declares it."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
    write_package(folder, project["name"], project["entry-points"])
    shutil.copytree(EXAMPLE / "acme_survey", folder / "acme_survey", ignore=shutil.ignore_patterns("__pycache__"))


@contextmanager
def importable(folder: Path) -> Iterator[None]:
    """Put a folder on the module search path; modules that were imported from it are forgotten afterwards."""
    with mock.patch.object(sys, "path", [str(folder), *sys.path]):
        try:
            yield
        finally:
            for name, module in [*sys.modules.items()]:
                if str(getattr(module, "__file__", None) or "").startswith(str(folder)):
                    del sys.modules[name]
