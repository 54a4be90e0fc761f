"""What ships with the code: metadata, licence, scripts and examples."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from auv_mcm import __version__
from auv_mcm.shell.registry import SOURCES

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


def test_version_is_the_same_everywhere() -> None:
    assert PROJECT["project"]["version"] == __version__
    assert "## [Unreleased]" in (ROOT / "CHANGELOG.md").read_text("utf-8")


def test_the_command_exists() -> None:
    module, _, function = PROJECT["project"]["scripts"]["auv-mcm"].partition(":")
    assert callable(getattr(importlib.import_module(module), function))


@pytest.mark.parametrize("target", SOURCES.values())
def test_every_source_of_the_registry_exists(target: str) -> None:
    module, _, function = target.partition(":")
    assert callable(getattr(importlib.import_module(module), function))


def test_licence_is_apache_2() -> None:
    text = (ROOT / "LICENSE").read_text("utf-8")
    assert "Apache License" in text
    assert "Version 2.0, January 2004" in text
    assert "END OF TERMS AND CONDITIONS" in text
    assert PROJECT["project"]["license"] == "Apache-2.0"


@pytest.mark.parametrize("script", sorted(path.name for path in (ROOT / "deploy").glob("*.sh")))
def test_scripts_are_plain_sh_that_stops_at_errors(script: str) -> None:
    path = ROOT / "deploy" / script
    text = path.read_text("utf-8")
    assert text.startswith("#!/bin/sh\n")
    assert re.search(r"^set -eu$", text, re.MULTILINE)
    subprocess.run(["sh", "-n", str(path)], check=True)


def test_ci_runs_the_test_command_of_the_readme() -> None:
    script = ROOT / ".ci" / "run"
    assert os.access(script, os.X_OK)
    assert "sh deploy/test.sh" in script.read_text("utf-8")
    readme = (ROOT / "README.md").read_text("utf-8")
    assert "sh deploy/test.sh" in readme
    assert "sh deploy/demo.sh" in readme


@pytest.mark.parametrize(
    ("python", "message"),
    [("no-python", "PYTHON=no-python is no Python 3.11 or later"), ("", "sudo apt-get install python3 python3-venv")],
)
def test_a_script_without_a_fit_python_says_what_to_do(python: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "dirname").symlink_to("/usr/bin/dirname")  # the one tool on the path: no python of any name
    command = ["/bin/sh", str(ROOT / "deploy" / "venv.sh"), "bench"]
    done = subprocess.run(
        command, env={"PATH": str(tmp_path), "PYTHON": python}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert message in done.stderr
