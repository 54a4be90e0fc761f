"""Find what is misspelt in expectations: it never occurs, so that one that there is none of it would always pass.

A name is known where the sources of the packages hold it, or its words: a counter may have values in its name. Where
an installation has no sources, every name passes, and a warning says so.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Collection
from functools import cache
from pathlib import Path
from typing import Final

import auv_mcm
import drivers
import sim_replay

log = logging.getLogger(__name__)

_ALL: Final = tuple(Path(str(package.__file__)).parent for package in (auv_mcm, drivers, sim_replay))
_FAKES: Final = (Path(__file__).parents[1] / "fakes",)
_WORD: Final = re.compile(r"[a-z]+")
_LITERAL: Final = re.compile(r'"([a-z0-9_.]+)"')
_BEGINNING: Final = re.compile(r'f"([a-z]+[_.])\{')  # of what ends in a value, which is a literal elsewhere
_WILD: Final = re.compile(r"\[[^]]*\]|[*?]")


def is_notice(code: str) -> bool:
    """Find whether the service may raise a notice with this code."""
    literals = _held(_ALL, _LITERAL)
    beginnings = [begin for begin in _held(_ALL, _BEGINNING) if code.startswith(begin)]
    is_known = code in literals or any(code.removeprefix(begin) in literals for begin in beginnings)
    return is_known or not _has_sources(_ALL)


def is_report(what: str) -> bool:
    """Find whether a fake device may report this."""
    return what in _held(_FAKES, _LITERAL) or not _has_sources(_ALL)


def is_counter(pattern: str, ports: Collection[str]) -> bool:
    """Find whether the service may count what the pattern matches; ports: names of its ports."""
    return _has_words(pattern, _held(_ALL, _WORD).union(*(_WORD.findall(port) for port in ports)))


def is_device_counter(name: str) -> bool:
    """Find whether a fake device may count this."""
    return _has_words(name, _held(_FAKES, _WORD))


def _has_words(pattern: str, known: Collection[str]) -> bool:
    """Find whether each word of a pattern is known, or, beside a wildcard, a part of one that is."""
    plain = _WILD.sub("*", pattern)
    for match in _WORD.finditer(plain):
        is_part = "*" in plain[max(match.start() - 1, 0) : match.end() + 1]
        if match[0] not in known and not (is_part and any(match[0] in word for word in known)):
            return not _has_sources(_ALL)
    return True


@cache
def _held(folders: tuple[Path, ...], pattern: re.Pattern[str]) -> frozenset[str]:
    texts = (path.read_text("utf-8") for folder in folders for path in folder.rglob("*.py"))
    return frozenset(found for text in texts for found in pattern.findall(text))


@cache
def _has_sources(folders: tuple[Path, ...]) -> bool:
    has_sources = any(True for folder in folders for _ in folder.rglob("*.py"))
    if not has_sources:
        log.warning("this installation has no sources: misspelt names in expectations are not found, and always pass")
    return has_sources
