"""The install script keeps a version in a folder of its own and a way back, and leaves what a person changed.

A stand-in for Python makes the environments: making real ones takes half a minute each.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

DEPLOY = Path(__file__).parents[2] / "deploy"
RULES = Path("etc/udev/rules.d/99-auv-mcm.rules")
PYTHON = """#!/bin/sh
case "$*" in
"-m venv "*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" && cp "$0" "$3/bin/auv-mcm" ;;
"-m pip install "*) case "$*" in *missing*) exit 1 ;; esac ;;
*"print(sysconfig."*) dirname "$0" ;;
*"print(kernels."*) echo c ;;
esac
"""


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """A folder as deploy/wheelhouse.sh makes it, with one wheel that says nothing."""
    folder = tmp_path / "bundle"
    shutil.copytree(DEPLOY, folder / "deploy")
    (folder / "wheels").mkdir()
    release(folder, "1.0.0")
    (tmp_path / "python").write_text(PYTHON)
    (tmp_path / "python").chmod(0o755)
    return folder


def release(bundle: Path, version: str) -> None:
    for old in (bundle / "wheels").iterdir():
        old.unlink()
    name = f"auv_mcm-{version}-cp311-cp311-linux_x86_64.whl"
    (bundle / "wheels" / name).write_text(version)
    (bundle / "wheels.sha256").write_text(f"{hashlib.sha256(version.encode()).hexdigest()}  {name}\n")


def install(bundle: Path, *options: str) -> subprocess.CompletedProcess[str]:
    root = bundle.parent / "root"
    return subprocess.run(
        ["sh", bundle / "deploy" / "install.sh", "--root", root, *options],
        env={**os.environ, "PYTHON": str(bundle.parent / "python")},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


def installed(bundle: Path, link: str = "current") -> str:
    """The version that a link points to."""
    return (bundle.parent / "root" / "opt" / "auv-mcm" / link).resolve(strict=True).name.partition("-")[0]


def test_an_installation_has_the_unit_its_user_and_names_for_ports(bundle: Path) -> None:
    done = install(bundle)
    assert done.returncode == 0, done.stderr
    assert "next, write /etc/auv-mcm/vehicle.yaml" in done.stdout
    root = bundle.parent / "root"
    for path, source in (
        ("etc/systemd/system/auv-mcm.service", "systemd/auv-mcm.service"),
        ("etc/sysusers.d/auv-mcm.conf", "systemd/auv-mcm.sysusers.conf"),
        (RULES, "udev/99-auv-mcm.rules"),
    ):
        assert (root / path).read_text() == (DEPLOY / source).read_text()
    program = (root / "opt/auv-mcm/current/bin/auv-mcm").relative_to(root)
    assert f"ExecStart=/{program} run" in (root / "etc/systemd/system/auv-mcm.service").read_text()
    assert not (root / "etc/tmpfiles.d").exists(), "sessions are removed only where that is asked for"


def test_an_upgrade_keeps_the_version_before_and_rollback_goes_back_to_it(bundle: Path) -> None:
    for version in ("1.0.0", "1.1.0", "1.2.0"):
        release(bundle, version)
        assert install(bundle).returncode == 0
        assert installed(bundle) == version
    versions = bundle.parent / "root" / "opt" / "auv-mcm" / "versions"
    assert sorted(path.name.partition("-")[0] for path in versions.iterdir()) == ["1.1.0", "1.2.0"]
    assert install(bundle, "--rollback").returncode == 0
    assert (installed(bundle), installed(bundle, "previous")) == ("1.1.0", "1.2.0")


def test_an_upgrade_that_fails_leaves_the_version_that_runs(bundle: Path) -> None:
    assert install(bundle).returncode == 0
    release(bundle, "1.1.0")
    failed = install(bundle, "--with", "missing-driver")
    assert failed.returncode == 1
    assert "packages are missing or are for another Python" in failed.stderr
    assert installed(bundle) == "1.0.0"


def test_installing_the_same_again_changes_nothing(bundle: Path) -> None:
    assert install(bundle).returncode == 0
    again = install(bundle)
    assert (again.returncode, "is installed already" in again.stdout) == (0, True)
    assert not (bundle.parent / "root" / "opt" / "auv-mcm" / "previous").exists()


def test_changed_rules_of_udev_are_left_with_a_word(bundle: Path) -> None:
    assert install(bundle).returncode == 0
    (bundle.parent / "root" / RULES).write_text("# mine\n")
    assert f"/{RULES} differs" in install(bundle).stdout
    assert (bundle.parent / "root" / RULES).read_text() == "# mine\n"


def test_sessions_are_kept_as_many_days_as_asked(bundle: Path) -> None:
    assert install(bundle, "--keep-days", "14").returncode == 0
    assert " 14d\n" in (bundle.parent / "root" / "etc" / "tmpfiles.d" / "auv-mcm.conf").read_text()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--rollback"], "there is no version before this one"),
        (["--keep-days", "a week"], "give a number of days"),
        (["--keep-days"], "--keep-days wants a value"),
        (["--fast"], "--fast is not an option"),
    ],
)
def test_what_cannot_be_done_is_refused_with_the_reason(options: list[str], said: str, bundle: Path) -> None:
    done = install(bundle, *options)
    assert (done.returncode, said in done.stderr) == (1, True)


def test_a_python_in_a_home_folder_is_refused_because_the_service_cannot_see_it(bundle: Path) -> None:
    stand_in = bundle.parent / "python"
    stand_in.write_text(PYTHON.replace("esac", '*"os.path.realpath"*) echo /home/pilot/.pyenv/bin/python3 ;;\nesac'))
    done = install(bundle)
    assert (done.returncode, done.stderr.count("PYTHON=/usr/bin/python3 sh deploy/install.sh")) == (1, 1)
    assert not (bundle.parent / "root").exists()


def test_a_folder_without_wheels_names_what_makes_one(bundle: Path) -> None:
    shutil.rmtree(bundle / "wheels")
    assert "sh deploy/wheelhouse.sh makes such a folder" in install(bundle).stderr


# --- checksums ---


def damaged(bundle: Path) -> str:
    (bundle / "wheels" / "auv_mcm-1.0.0-cp311-cp311-linux_x86_64.whl").write_text("1.0.1")
    return "a wheel is damaged or was changed"


def one_more(bundle: Path) -> str:
    (bundle / "wheels" / "numpy-9.0-py3-none-any.whl").write_text("not numpy")
    return "numpy-9.0-py3-none-any.whl is not in"


def similar_name(bundle: Path) -> str:
    """A name that a pattern made of the listed one would match."""
    (bundle / "wheels" / "auv_mcm-1x0.0-cp311-cp311-linux_x86_64.whl").write_text("1.0.0")
    return "auv_mcm-1x0.0-cp311-cp311-linux_x86_64.whl is not in"


def one_less(bundle: Path) -> str:
    with (bundle / "wheels.sha256").open("a") as file:
        file.write(f"{'0' * 64}  numpy-2.0-py3-none-any.whl\n")
    return "a wheel is damaged or was changed"


def no_list(bundle: Path) -> str:
    (bundle / "wheels.sha256").unlink()
    return "copy the whole folder"


@pytest.mark.parametrize("change", [damaged, one_more, similar_name, one_less, no_list])
def test_wheels_that_are_not_those_of_the_list_are_not_installed(change: Callable[[Path], str], bundle: Path) -> None:
    said = change(bundle)
    done = install(bundle)
    assert (done.returncode, said in done.stderr) == (1, True), done.stderr
    assert not (bundle.parent / "root").exists()


def test_a_list_that_is_not_the_one_that_was_made_is_refused(bundle: Path) -> None:
    made = hashlib.sha256((bundle / "wheels.sha256").read_bytes()).hexdigest()
    assert "fetch the folder again" in install(bundle, "--sum", "0" * 64).stderr
    assert install(bundle, "--sum", made).returncode == 0
