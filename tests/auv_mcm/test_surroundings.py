"""What a command finds around it: packages of another version or missing, closed streams, a narrow terminal."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path
from unittest.mock import Mock

import cv2
import pytest

from auv_mcm import cli
from auv_mcm.classify.verifier import network_of
from auv_mcm.cli import main
from auv_mcm.settings.config import parse_config
from auv_mcm.shell.check.packages import IMPORTED_AS, parse_requirements
from tests.test_import_graph import TOPS, names_of

ROOT = Path(__file__).parents[2]


@pytest.mark.usefixtures("without_perception")
def test_check_fails_where_opencv_cannot_run_the_verifier(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of OpenCV 4, whose Gemm rejects the network: without it a replay goes on by the detector's `p_mine`."""
    monkeypatch.setattr("cv2.dnn.readNetFromONNX", Mock(side_effect=cv2.error("DNN/Gemm: Invalid dimension of dim K")))
    network_of.cache_clear()
    assert main(["check"]) == 5
    (failed,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("FAILED"))
    assert "odds of confirmation" in failed
    assert "Install OpenCV 5" in failed


def test_every_package_that_the_bench_imports_has_an_extra_that_brings_it() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    base = {IMPORTED_AS.get(one.name, one.name) for one in parse_requirements(project["dependencies"])[""]}
    known = {*sys.stdlib_module_names, *TOPS, *base, *(name for names in cli._EXTRAS.values() for name in names)}
    imported = {name.partition(".")[0] for path in (ROOT / "sim_replay").rglob("*.py") for name in names_of(path)}
    assert imported - known == set()


@pytest.mark.parametrize("closed", [(0,), (1,), (2,), (0, 1, 2)])
def test_a_command_whose_streams_are_closed_does_its_work(closed: tuple[int, ...], tmp_path: Path) -> None:
    out = tmp_path / "config.yaml"
    shell = 'exec "$@" ' + " ".join(f"{number}>&-" for number in closed)
    command = ["sh", "-c", shell, "sh", sys.executable, "-m", "auv_mcm", "config", "--write", str(out)]
    assert subprocess.run(command, cwd=ROOT, capture_output=True, timeout=120, check=False).returncode == 0
    parse_config(out.read_text("utf-8"), "config.yaml")
    failed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert (failed.returncode, "Traceback" in failed.stderr) == (2, False), "the file is there"


def test_help_fits_a_terminal_of_one_column_without_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "1")
    with pytest.raises(SystemExit, match="0"):
        main(["config", "--help"])
