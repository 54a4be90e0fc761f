"""Define the exceptions of this project.

AuvMcmError
├── UsageError      bad command line or configuration (exit code 2); e.g. an unknown configuration key
├── BadInputError   input data nothing can be made of (exit code 3); e.g. an XTF file without side-scan channels
├── HardwareError   a port, bus or link failed (exit code 4); e.g. a serial device that does not exist
└── SelfCheckError  this installation does not do what it should (exit code 5); e.g. kernel and numpy disagree

Every message says what is wrong, where, and what to do.
"""

from __future__ import annotations

from typing import ClassVar, TypeVar

E = TypeVar("E", bound=BaseException)


class AuvMcmError(Exception):
    """Serve as the base of all errors meant for a person; `exit_code` is what the command line returns."""

    exit_code: ClassVar[int] = 1


class UsageError(AuvMcmError):
    """Report bad usage or a bad configuration."""

    exit_code: ClassVar[int] = 2


class BadInputError(AuvMcmError):
    """Report input data that cannot be used."""

    exit_code: ClassVar[int] = 3


class HardwareError(AuvMcmError):
    """Report hardware or a link that failed."""

    exit_code: ClassVar[int] = 4


class SelfCheckError(AuvMcmError):
    """Report a failed self-check."""

    exit_code: ClassVar[int] = 5


def first_of(group: BaseExceptionGroup[E]) -> E:
    """Return the first error of a group, however deep it lies."""
    error = group.exceptions[0]
    return first_of(error) if isinstance(error, BaseExceptionGroup) else error
