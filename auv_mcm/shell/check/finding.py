"""Hold one line of the self-check."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

Verdict: TypeAlias = Literal["ok", "warning", "FAILED"]


class Finding(NamedTuple):
    """Hold one line of the self-check.

    `warning`: it works, but less well, or could not be judged. detail: what, where and what to do.
    """

    name: str
    verdict: Verdict
    detail: str
