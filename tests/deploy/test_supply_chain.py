"""What is installed: dependencies bounded on both sides, a bill of materials from the wheels, and a look-up offline."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parents[2]

# The first version without a weakness that is published, and where.
SOUND = {
    "aiohttp": ("3.13.3", "CVE-2025-69223 and six more"),
    "distributed": ("2026.1.0", "CVE-2026-23528"),
    "h5py": ("3.14.0", "holds HDF5 1.14.6, after some thirty overflows"),
    "jinja2": ("3.1.6", "CVE-2025-27516"),
    "onnx": ("1.21.0", "CVE-2025-51480 and later ones of the same kind"),
    "opencv-contrib-python-headless": ("4.12.0", "CVE-2025-53644"),
    "pillow": ("11.3.0", "CVE-2025-48379"),
    "protobuf": ("6.33.5", "CVE-2025-4565, CVE-2026-0994"),
    "pymdown-extensions": ("10.16.1", "CVE-2025-68142"),
    "pytest": ("9.0.3", "CVE-2025-71176"),
    "pyyaml": ("5.4", "CVE-2020-14343"),
    "setuptools": ("78.1.1", "CVE-2025-47273"),
    "torch": ("2.8.0", "CVE-2025-32434, CVE-2025-3730"),
}


def requirements() -> list[Requirement]:
    """Everything that pyproject.toml names, that which builds too."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = project["project"]["optional-dependencies"].values()
    lines = [*project["build-system"]["requires"], *project["project"]["dependencies"]]
    return [Requirement(line) for line in [*lines, *(line for extra in extras for line in extra)]]


@pytest.mark.parametrize("requirement", requirements(), ids=lambda requirement: requirement.name)
def test_every_dependency_is_bounded_below_and_above(requirement: Requirement) -> None:
    operators = {specifier.operator for specifier in requirement.specifier}
    assert operators == {">=", "<"}


@pytest.mark.parametrize("requirement", requirements(), ids=lambda requirement: requirement.name)
def test_no_lower_bound_admits_a_published_weakness(requirement: Requirement) -> None:
    sound, _ = SOUND.get(requirement.name.lower(), ("0", ""))
    (lowest,) = (one.version for one in requirement.specifier if one.operator == ">=")
    assert Version(lowest) >= Version(sound)


def test_what_builds_the_wheel_is_pinned_within_its_bounds() -> None:
    (pinned,) = re.findall(r"^setuptools==(.+)$", (ROOT / "deploy" / "build-requirements.txt").read_text(), re.M)
    (bounds,) = (one.specifier for one in requirements() if one.name == "setuptools")
    assert pinned in bounds


# --- the bill of materials ---


def wheel(folder: Path, name: str, version: str, *lines: str) -> Path:
    path = folder / f"{name.replace('-', '_')}-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        text = "\n".join(("Metadata-Version: 2.4", f"Name: {name}", f"Version: {version}", *lines, "", "Text: a, b\n"))
        archive.writestr(zipfile.ZipInfo(f"{name.replace('-', '_')}-{version}.dist-info/METADATA"), text)
    return path


@pytest.fixture
def wheels(tmp_path: Path) -> Path:
    folder = tmp_path / "wheels"
    folder.mkdir()
    wheel(folder, "Some_Package", "1.2", "License-Expression: MIT", "Requires-Dist: other.one>=1; extra == 'x'")
    wheel(folder, "other-one", "3.0", "Classifier: License :: OSI Approved :: BSD License", "Requires-Dist: absent")
    return folder


def run(script: str, *arguments: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "deploy" / script), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


def test_the_bill_of_materials_says_what_the_wheels_say(wheels: Path) -> None:
    bill = json.loads(run("sbom.py", wheels).stdout)
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
    one, other = sorted(bill["components"], key=lambda part: str(part["name"]), reverse=True)
    assert (one["purl"], one["licenses"]) == ("pkg:pypi/some-package@1.2", [{"expression": "MIT"}])
    assert other["licenses"] == [{"license": {"name": "BSD License"}}]
    assert all(re.fullmatch("[0-9a-f]{64}", part["hashes"][0]["content"]) for part in (one, other))
    assert {entry["ref"]: entry["dependsOn"] for entry in bill["dependencies"]} == {
        "pkg:pypi/some-package@1.2": ["pkg:pypi/other-one@3.0"],
        "pkg:pypi/other-one@3.0": [],
    }


def test_equal_wheels_give_an_equal_bill_and_others_another_number(wheels: Path) -> None:
    first = run("sbom.py", wheels).stdout
    assert run("sbom.py", wheels).stdout == first
    wheel(wheels, "other-one", "3.1")
    assert json.loads(run("sbom.py", wheels).stdout)["serialNumber"] != json.loads(first)["serialNumber"]


def test_a_folder_without_wheels_and_a_file_that_is_none_are_refused(tmp_path: Path) -> None:
    assert "holds no wheel" in run("sbom.py", tmp_path).stderr
    (tmp_path / "a.whl").write_text("no ZIP")
    done = run("sbom.py", tmp_path)
    assert (done.returncode, done.stdout) == (1, "")


# --- the look-up ---


@pytest.fixture
def bill(wheels: Path) -> Path:
    path = wheels.parent / "sbom.cdx.json"
    path.write_text(run("sbom.py", wheels).stdout)
    return path


def database(path: Path, version: str, **entry: object) -> Path:
    affected = [{"package": {"ecosystem": "PyPI", "name": "some.package"}, "versions": ["1.0", version]}]
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("A.json", json.dumps({"id": "GHSA-1", "aliases": ["CVE-1"], "affected": affected, **entry}))
    return path


def test_a_known_weakness_is_found_by_name_and_version(bill: Path) -> None:
    done = run("audit.py", bill, database(bill.with_name("osv.zip"), "1.2", summary="reads too far"))
    assert done.returncode == 1
    assert "some-package 1.2: GHSA-1, CVE-1: reads too far" in done.stdout


@pytest.mark.parametrize(("version", "entry"), [("1.3", {}), ("1.2", {"withdrawn": "2026-01-01"})])
def test_other_versions_and_withdrawn_entries_are_none(version: str, entry: dict[str, object], bill: Path) -> None:
    assert run("audit.py", bill, database(bill.with_name("osv.zip"), version, **entry)).returncode == 0


def test_without_a_database_nothing_passes(bill: Path) -> None:
    assert run("audit.py", bill, bill.with_name("none.zip")).returncode == 2
