"""One command makes every file again that the payload has learnt; a stand-in for auv-mcm writes what it was asked."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from pathlib import Path

import msgspec
import pytest

ROOT = Path(__file__).parents[2]
AUV_MCM = """#!/bin/sh
case "$*" in *"$(cat fails)"*) exit 4 ;; esac
for out; do :; done
echo "$*" >>asked
case "$*" in
*" verifier "*) mkdir "$out" && echo network >"$out/verifier.onnx" && echo "$*" >"$out/mine_odds_cascade.json" ;;
*) echo "$*" >"$out" ;;
esac
"""
LEARNT = sorted(
    str(path.relative_to(ROOT))
    for pattern in ("*.json", "*.onnx")
    for path in (ROOT / "auv_mcm").rglob(pattern)
    if "docs" not in path.parts
)


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout of the files that were learnt and of the script."""
    for name in (*LEARNT, "deploy/models.sh"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / "deploy/venv.sh").write_text("")
    program = tmp_path / ".venv/bin/auv-mcm"
    program.parent.mkdir(parents=True)
    program.write_text(AUV_MCM)
    program.chmod(0o755)
    (tmp_path / "fails").write_text("nothing")
    for command in ("init -q", "add .", "-c user.name=a -c user.email=a@b commit -qm all"):
        subprocess.run(["git", *command.split()], cwd=tmp_path, check=True, capture_output=True, timeout=60)
    return tmp_path


def made(checkout: Path) -> subprocess.CompletedProcess[str]:
    command = ["sh", "deploy/models.sh", "made"]
    return subprocess.run(command, cwd=checkout, capture_output=True, text=True, check=False, timeout=60)


def test_every_file_that_was_learnt_is_made_and_stands_in_the_manifest(checkout: Path) -> None:
    done = made(checkout)
    assert done.returncode == 0, done.stderr
    manifest = (checkout / "made/manifest.txt").read_text()
    for name in LEARNT:
        data = (checkout / name).read_bytes()
        assert data != (ROOT / name).read_bytes(), f"{name} was not made"
        assert f"{name}: changed, " in manifest
        assert hashlib.sha256(data).hexdigest() in manifest


def test_what_ships_was_made_with_the_options_of_the_script(checkout: Path) -> None:
    made(checkout)
    asked = (checkout / "asked").read_text()
    odds = msgspec.json.decode((ROOT / "auv_mcm/classify/mine_odds_cascade.json").read_bytes())
    assert "--crowded 3 --drawn 100" in odds["made_by"]
    assert "calibrate odds --crowded 3 --drawn 100" in asked


def test_an_interrupted_run_goes_on_where_it_was(checkout: Path) -> None:
    (checkout / "fails").write_text("calibrate gate")
    assert made(checkout).returncode != 0
    before = (checkout / "asked").read_text()
    (checkout / "fails").write_text("nothing")
    assert made(checkout).returncode == 0
    after = (checkout / "asked").read_text()
    assert after.startswith(before)
    assert len(set(after.splitlines())) == len(after.splitlines()) == 9
