"""The parts of the self-check, judged one by one."""

from __future__ import annotations

import errno
import os
import tempfile
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import pytest

from auv_mcm.errors import UsageError
from auv_mcm.shell.check import expected_mines
from auv_mcm.shell.check.host import (
    Discipline,
    clock_discipline,
    clock_finding,
    output_finding,
    reach_findings,
    user_findings,
)
from auv_mcm.shell.check.packages import Requirement, package_findings, parse_requirements
from auv_mcm.shell.whole_files import make_directory

PACKAGE = Path(__file__).parents[3] / "auv_mcm"
DECLARED = ["numpy<3,>=2.0", "mcap<2,>=1.5", 'pyxtf<2,>=1.4; extra == "bench"', 'rich<16,>=13; extra == "bench"']


def installed(versions: dict[str, str]) -> Callable[[str], str]:
    def version(name: str) -> str:
        if name not in versions:
            raise metadata.PackageNotFoundError(name)
        return versions[name]

    return version


@pytest.fixture
def declared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metadata, "requires", lambda name: DECLARED)


@pytest.mark.parametrize(
    ("limits", "version", "allowed"),
    [
        ("<3,>=2.0", "2.4.6", True),
        ("<3,>=2.0", "1.26.4", False),
        ("<3,>=2.0", "3.0", False),
        (">=2.0", "2", True),
        ("<5,>=4.10", "4.9.1", False),
        ("<5,>=4.10", "4.10.0.84", True),
        ("==1.2.*", "1.2.9", True),
        ("==1.2.*", "1.3", False),
        ("!=1.2", "1.2.0", False),
        (">=2024.8", "2026.8.0", True),
        ("", "0.1", True),
    ],
)
def test_versions_are_compared_number_by_number(limits: str, version: str, allowed: bool) -> None:
    assert Requirement("any", limits).allows(version) is allowed


def test_requirements_are_sorted_by_extra() -> None:
    assert parse_requirements(DECLARED) == {
        "": [Requirement("numpy", "<3,>=2.0"), Requirement("mcap", "<2,>=1.5")],
        "bench": [Requirement("pyxtf", "<2,>=1.4"), Requirement("rich", "<16,>=13")],
    }


def test_every_declared_base_package_is_looked_at() -> None:
    names = [finding.name for finding in package_findings()]
    assert not {"mkdocs", "pytest"} & set(names)  # of use to those alone who change the code
    base = parse_requirements(metadata.requires("auv-mcm") or [])[""]
    assert names[: len(base)] == [requirement.name for requirement in base]
    assert "mcap" in names


@pytest.mark.usefixtures("declared")
def test_a_base_package_that_is_missing_or_of_a_wrong_version_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metadata, "version", installed({"numpy": "1.26.4"}))
    numpy, mcap, bench = package_findings()
    assert (numpy.verdict, numpy.detail) == (
        "FAILED",
        "version 1.26.4 is not one of <3,>=2.0: python -m pip install auv-mcm",
    )
    assert (mcap.verdict, mcap.detail) == (
        "FAILED",
        "not installed, but needed (<2,>=1.5): python -m pip install auv-mcm",
    )
    assert bench.verdict == "warning"
    assert "no pyxtf, rich" in bench.detail


@pytest.mark.usefixtures("declared")
def test_an_installed_extra_of_a_wrong_version_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        metadata, "version", installed({"numpy": "2.1", "mcap": "1.5", "pyxtf": "1.4.2", "rich": "12.0"})
    )
    verdicts = {finding.name: finding.verdict for finding in package_findings()}
    assert verdicts == {"numpy": "ok", "mcap": "ok", "pyxtf": "ok", "rich": "FAILED"}


def test_a_clock_from_before_the_installation_fails_and_says_how_to_set_it() -> None:
    found = clock_finding(86_400.0, Discipline(True, 0.001), PACKAGE, unit_gives_utc=False)
    assert found.verdict == "FAILED"
    assert "1970-01-02" in found.detail
    assert "date --utc --set" in found.detail
    year_s = 365 * 86_400.0
    assert (
        clock_finding(max(path.stat().st_mtime for path in PACKAGE.glob("*.py")) - year_s, None, PACKAGE, False).verdict
        == "FAILED"
    )


@pytest.mark.parametrize(
    ("discipline", "unit_gives_utc", "verdict", "statement"),
    [
        (Discipline(True, 0.012), False, "ok", "synchronised, maximum error 0.012 s"),
        (Discipline(False, 16.0), False, "warning", "not synchronised: times of contacts"),
        (Discipline(False, 16.0), True, "ok", "a navigation unit gives UTC"),
        (None, False, "ok", "cannot be seen here"),
    ],
)
def test_whether_the_clock_is_synchronised_is_reported(
    discipline: Discipline | None, unit_gives_utc: bool, verdict: str, statement: str
) -> None:
    found = clock_finding(time.time(), discipline, PACKAGE, unit_gives_utc)
    assert found.verdict == verdict
    assert statement in found.detail


def test_the_kernel_is_asked_without_changing_anything() -> None:
    first, again = clock_discipline(), clock_discipline()
    assert (first is None) == (again is None)
    assert first is None or first.max_error_s >= 0.0


def test_the_output_directory_is_left_as_it_was(tmp_path: Path) -> None:
    assert output_finding(tmp_path / "new" / "deep").verdict in ("ok", "warning")
    assert list(tmp_path.iterdir()) == []


def test_an_output_directory_below_a_file_or_behind_a_dead_link_fails(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for name in ("file", "link"):
        found = output_finding(tmp_path / name / "out")
        assert found.verdict == "FAILED"
        assert "is not a directory. Name another one (service.output_directory)" in found.detail


@pytest.mark.parametrize(
    ("reason", "remedy"),
    [
        (errno.EACCES, "Permission denied. Change its owner, or let the systemd unit wait for its disk by Requires"),
        (errno.EROFS, "Read-only file system. Mount it for writing, or add it to ReadWritePaths and RequiresMountsFor"),
        (errno.ENOSPC, "No space left on device. Free space on this disk, or name another one"),
        (errno.ENAMETOOLONG, "File name too long. Name another one"),
    ],
)
def test_an_output_directory_that_takes_no_file_names_the_reason_and_its_remedy(
    reason: int, remedy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(**_: object) -> None:  # root, as in a test, is refused nothing
        raise OSError(reason, os.strerror(reason))

    monkeypatch.setattr(tempfile, "TemporaryFile", refused)
    found = output_finding(tmp_path / "results")
    assert found.verdict == "FAILED"
    assert f"{tmp_path} cannot be written to: {remedy}" in found.detail
    with pytest.raises(UsageError, match=f": {remedy}"):  # as the service says that starts nevertheless
        make_directory(tmp_path / "results")


def test_root_is_sent_to_check_as_the_user_of_the_service() -> None:
    (found,) = user_findings(0)
    assert (found.verdict, "runuser -u auvmcm" in found.detail) == ("warning", True)
    assert list(user_findings(1000)) == []


def test_an_installation_in_a_folder_that_the_service_may_not_enter_is_named(tmp_path: Path) -> None:
    place = tmp_path / "closed" / "venv" / "bin" / "python"
    place.parent.mkdir(parents=True)
    outside = next((folder for folder in reversed(tmp_path.parents) if not folder.stat().st_mode & 0o001), None)
    (tmp_path / "closed").chmod(0o700)
    (found,) = reach_findings(0, [place], "nobody at all")
    named = outside or tmp_path / "closed"  # the folder of tests may be closed itself
    assert (found.verdict, found.detail.partition(":")[0]) == (
        "warning",
        f"{place} is below {named}, which nobody at all may not enter",
    )
    assert "Install below /opt with a Python of the system" in found.detail
    assert f"or allow it: chmod a+x {named}" in found.detail
    assert list(reach_findings(1000, [place], "nobody at all")) == []
    assert list(reach_findings(0, [Path("/usr/bin/python3")], "nobody at all")) == []


@pytest.mark.parametrize("place", ["/root/.pyenv/versions/3.12.1/bin/python3.12", "/home/pilot/venv/bin/python"])
def test_an_installation_that_the_unit_hides_is_named(place: str) -> None:
    (found,) = reach_findings(0, [Path(place)])
    assert "which the unit hides from the service (ProtectHome): systemd cannot start it. Install below" in found.detail


@pytest.mark.parametrize(("free_bytes", "verdict"), [(10 << 20, "FAILED"), (500 << 20, "warning"), (5 << 30, "ok")])
def test_room_on_the_disk_is_judged(
    free_bytes: int, verdict: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda path: _Usage(free_bytes))
    assert output_finding(tmp_path).verdict == verdict


class _Usage:
    def __init__(self, free_bytes: int) -> None:
        self.free = free_bytes


def test_a_list_of_mines_expected_is_shown_with_what_is_at_risk_where_it_is_incomplete(tmp_path: Path) -> None:
    path = tmp_path / "mines.yaml"
    path.write_text("mines:\n  - {name: type A, kind: cylinder, length_m: 1.6, diameter_m: 0.45}\n")
    finding = expected_mines(str(path), 0.02)
    assert finding.verdict == "ok"
    assert finding.detail.startswith("type A (cylinder): length 1.6 m, diameter 0.45 m, within 5 %. ")
    assert "1.2 nats in one view, by not_listed 0.3: p_mine 0.9 to 0.73, 0.5 to 0.23" in finding.detail
    assert "below 0.06 to less than contacts.min_p_mine" in finding.detail
    path.write_text("mines:\n  - {kind: sphere, diameter_m: 2.0}\n")
    unusual = expected_mines(str(path), 0.0)
    assert unusual.verdict == "warning"
    assert "Beyond the sizes that the odds of a mine were fitted on" in unusual.detail
