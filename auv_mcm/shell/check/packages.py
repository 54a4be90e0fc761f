"""Compare the packages of this installation with what the project declares."""

from __future__ import annotations

import importlib
import operator
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from importlib import metadata
from itertools import zip_longest
from typing import Final, NamedTuple

from auv_mcm.shell.check.finding import Finding

DISTRIBUTION: Final = "auv-mcm"
_BASE: Final = ""
_MAKERS: Final = ("dev", "docs")  # extras for those who change the code: the payload does not run them
IMPORTED_AS: Final = {
    "opencv-contrib-python-headless": "cv2",
    "protobuf": "google.protobuf",
    "pyserial": "serial",
    "python-can": "can",
    "pyyaml": "yaml",
    "mcap-protobuf-support": "mcap_protobuf",
    "fpdf2": "fpdf",
}
_WITHOUT: Final = {
    "bench": "replay, simulate, score, train, hil, bench and reports need it",
    "view": "view needs it",
    "cluster": "--scheduler needs it",
}
_REQUIREMENT: Final = re.compile(
    r"(?P<name>[A-Za-z0-9._-]+)\s*(?:\[[^\]]*\])?\s*\(?(?P<limits>[^;)]*)\)?\s*(?:;(?P<marker>.*))?"
)
_LIMIT: Final = re.compile(r"\s*(>=|<=|==|!=|<|>)\s*([0-9][^,\s]*)\s*")
_EXTRA: Final = re.compile(r"""extra\s*==\s*["']([^"']+)["']""")
_COMPARE: Final[dict[str, Callable[[tuple[int, ...], tuple[int, ...]], bool]]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
}


class Requirement(NamedTuple):
    """Name a package that the project declares. limits: of its version, as declared, e.g. `<3,>=2.0`."""

    name: str
    limits: str

    def allows(self, version: str) -> bool:
        """Compare the numbers of a version with the limits; a limit in another notation is not judged."""
        found = [_LIMIT.fullmatch(limit) for limit in self.limits.split(",")]
        return all(_holds(version, limit[1], limit[2]) for limit in found if limit is not None)


def parse_requirements(declared: Sequence[str]) -> dict[str, list[Requirement]]:
    """Sort requirements, as package metadata hold them, by extra; the base is the extra named ''."""
    by_extra: dict[str, list[Requirement]] = defaultdict(list)
    for text in declared:
        match = _REQUIREMENT.fullmatch(text.strip())
        if match is None:
            continue
        extra = _EXTRA.search(match["marker"] or "")
        by_extra[_BASE if extra is None else extra[1]].append(Requirement(match["name"], match["limits"].strip()))
    return dict(by_extra)


def package_findings() -> Iterator[Finding]:
    """Check every package that the base needs, and those of each extra that is installed."""
    try:
        by_extra = parse_requirements(metadata.requires(DISTRIBUTION) or [])
    except metadata.PackageNotFoundError:
        text = (
            f"{DISTRIBUTION} itself is not installed, so that what it needs is not known: python -m pip install "
            f"{DISTRIBUTION}"
        )
        yield Finding("packages", "FAILED", text)
        return
    for requirement in by_extra.pop(_BASE, []):
        yield _finding(requirement, f"python -m pip install {DISTRIBUTION}")
    for extra in _MAKERS:
        by_extra.pop(extra, None)
    for extra, requirements in by_extra.items():
        install = f"python -m pip install '{DISTRIBUTION}[{extra}]'"
        if missing := [requirement.name for requirement in requirements if _version(requirement.name) is None]:
            needed_by = _WITHOUT.get(extra, "some commands need it")
            yield Finding(
                f"extra {extra}",
                "warning",
                f"not installed (no {', '.join(missing)}): {needed_by}. On the bench: {install}",
            )
            continue
        for requirement in requirements:
            yield _finding(requirement, install)


def has_extra(extra: str) -> bool:
    """Check whether all packages of an extra are installed."""
    try:
        requirements = parse_requirements(metadata.requires(DISTRIBUTION) or []).get(extra, [])
    except metadata.PackageNotFoundError:
        return False
    return all(_version(requirement.name) is not None for requirement in requirements)


def _finding(requirement: Requirement, install: str) -> Finding:
    name = requirement.name
    version = _version(name)
    if version is None:
        return Finding(name, "FAILED", f"not installed, but needed ({requirement.limits or 'any version'}): {install}")
    if not requirement.allows(version):
        return Finding(name, "FAILED", f"version {version} is not one of {requirement.limits}: {install}")
    module = IMPORTED_AS.get(name.lower(), name.replace("-", "_"))
    try:
        importlib.import_module(module)
    except Exception as error:  # a broken package raises whatever it likes
        reason = str(error).splitlines()[0] if str(error) else ""
        return Finding(
            name, "FAILED", f"version {version} cannot be imported ({type(error).__name__}: {reason}): {install}"
        )
    return Finding(name, "ok", version)


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _holds(version: str, comparison: str, limit: str) -> bool:
    if limit.endswith(".*"):
        wanted = _numbers(limit[:-2])
        is_within = _numbers(version)[: len(wanted)] == wanted
        return is_within if comparison == "==" else not is_within if comparison == "!=" else True
    ours, theirs = zip(*zip_longest(_numbers(version), _numbers(limit), fillvalue=0), strict=True)
    return _COMPARE[comparison](ours, theirs)


def _numbers(version: str) -> tuple[int, ...]:
    """Read the numbers of a release, e.g. (4, 10, 0) of 4.10.0rc1."""
    release = re.match(r"[0-9]+(\.[0-9]+)*", version)
    return tuple(int(part) for part in release[0].split(".")) if release else (0,)
