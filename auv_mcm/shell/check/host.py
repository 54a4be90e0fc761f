"""Check the computer that the service runs on: its clock, and the disk that results go to."""

from __future__ import annotations

import ctypes
import os
import pwd
import shutil
import stat
import tempfile
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, NamedTuple

from auv_mcm.shell.check.finding import Finding
from auv_mcm.shell.whole_files import why_refused

PLENTY_BYTES: Final = 1 << 30
"""Free space for a day: a full serial line of 921600 baud records 0.33 GB an hour, three hours of it."""
NEEDED_BYTES: Final = 64 << 20
"""Free space without which not all results can be written: those of a mission of 40 min take some 45 MB."""
SERVICE_USER: Final = "auvmcm"
"""The user that deploy/systemd/auv-mcm.service runs as."""
_HIDDEN: Final = (Path("/home"), Path("/root"), Path("/run/user"))  # by ProtectHome= of a systemd unit
_DAY_S: Final = 86_400.0  # times of files out of archives are local ones, whose zone is not known
_FIRST_UTC_S: Final = datetime(2025, 1, 1, tzinfo=UTC).timestamp()  # there was no version of this package before

_UNSYNCHRONISED: Final = 0x40  # STA_UNSYNC of linux/timex.h
_TIME_ERROR: Final = 5  # TIME_ERROR, what adjtimex returns for a clock that is not disciplined


class Discipline(NamedTuple):
    """State whether the system's clock is synchronised, and the maximum error that the kernel states for it, s."""

    is_synchronised: bool
    max_error_s: float


def user_findings(user_id: int) -> Iterator[Finding]:
    """Warn of root, which may open every port and write everywhere, so that the rights of another user are not seen."""
    if user_id == 0:
        text = (
            "root may do everything, so that rights of the service's user are not checked. Check as that user: "
            "runuser -u auvmcm -- auv-mcm check ..."
        )
        yield Finding("user", "warning", text)


def reach_findings(user_id: int, places: Iterable[Path], user: str = SERVICE_USER) -> Iterator[Finding]:
    """Warn where root may read an installation that the service's user may not.

    Parameters
    ----------
    user_id
        Who checks. Another user than root who can check can read it.
    places
        Interpreter and packages, without links.
    user
        Whom the service runs as; where there is no such user, somebody without any rights of their own.
    """
    if user_id != 0:
        return
    for place in places:
        hidden = next((folder for folder in _HIDDEN if place.is_relative_to(folder)), None)
        closed = None if hidden else next((one for one in reversed(place.parents) if not _may_enter(one, user)), None)
        if hidden or closed:
            why = (
                f"below {hidden}, which the unit hides from the service (ProtectHome)"
                if hidden
                else f"below {closed}, which {user} may not enter"
            )
            remedy = "Install below /opt with a Python of the system: PYTHON=/usr/bin/python3 sh deploy/install.sh"
            open_it = "" if hidden else f", or allow it: chmod a+x {closed}"
            yield Finding("installation", "warning", f"{place} is {why}: systemd cannot start it. {remedy}{open_it}")
            return


def _may_enter(folder: Path, user: str) -> bool:
    found = folder.stat()
    try:
        account = pwd.getpwnam(user)
        groups = os.getgrouplist(user, account.pw_gid)
    except KeyError:
        return bool(found.st_mode & stat.S_IXOTH)
    if found.st_uid == account.pw_uid:
        return bool(found.st_mode & stat.S_IXUSR)
    return bool(found.st_mode & (stat.S_IXGRP if found.st_gid in groups else stat.S_IXOTH))


def clock_finding(utc_s: float, discipline: Discipline | None, package: Path, unit_gives_utc: bool) -> Finding:
    """Judge the system's clock.

    Parameters
    ----------
    utc_s
        What it shows.
    discipline
        What the kernel reports of it, None if that is not known.
    package
        Folder of files that cannot be from the future.
    unit_gives_utc
        A navigation unit gives UTC, so that times are not this computer's.
    """
    shown = (
        datetime.fromtimestamp(utc_s, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
        if 0.0 <= utc_s < 2.5e11
        else f"{utc_s:g} s"
    )
    earliest_s = max([_FIRST_UTC_S, *(path.stat().st_mtime - _DAY_S for path in package.glob("*.py"))])
    if utc_s < earliest_s:
        since = datetime.fromtimestamp(earliest_s, UTC).date()
        text = (
            f"shows {shown}, which is before this installation was made ({since}). Set it, e.g. date --utc --set, or "
            "start chrony"
        )
        return Finding("clock", "FAILED", text)
    if discipline is None:
        return Finding("clock", "ok", f"{shown}; whether it is synchronised cannot be seen here")
    if discipline.is_synchronised:
        return Finding("clock", "ok", f"{shown}, synchronised, maximum error {discipline.max_error_s:.3g} s")
    if unit_gives_utc:
        return Finding("clock", "ok", f"{shown}, not synchronised; a navigation unit gives UTC")
    text = (
        f"{shown}, not synchronised: times of contacts are as right as it was set. Start chrony or another time "
        "service, or set "
    )
    return Finding("clock", "warning", text + "navigation.gives_utc of a unit that sends ZDA")


def clock_discipline() -> Discipline | None:
    """Query the kernel whether the clock is synchronised; None where it does not state it. Changes nothing."""
    # struct timex: modes, offset, freq, maxerror (us), esterror, status, ...; modes 0 reads
    timex = (ctypes.c_long * 64)()
    try:
        state = ctypes.CDLL(None).adjtimex(ctypes.byref(timex))
    except (AttributeError, OSError):
        return None
    if state < 0:
        return None
    status = ctypes.cast(
        ctypes.byref(timex, 5 * ctypes.sizeof(ctypes.c_long)), ctypes.POINTER(ctypes.c_int)
    ).contents.value
    return Discipline(state != _TIME_ERROR and not status & _UNSYNCHRONISED, timex[3] * 1e-6)


def output_finding(folder: Path) -> Finding:
    """Check whether the directory for results can be made or written to, and its free space. Leaves nothing behind."""
    name, key = "output directory", "service.output_directory"
    existing = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if os.path.lexists(parent))
    if not existing.is_dir():
        return Finding(name, "FAILED", f"{existing} is not a directory. Name another one ({key})")
    try:
        with tempfile.TemporaryFile(dir=existing) as probe:
            probe.write(b"\0")
            probe.flush()
        free_bytes = shutil.disk_usage(existing).free
    except OSError as error:
        return Finding(name, "FAILED", f"{existing} cannot be written to: {why_refused(error)} another one ({key})")
    room = f"{folder.absolute()}, {free_bytes / 1e9:.2g} GB free"
    if free_bytes < NEEDED_BYTES:
        return Finding(
            name, "FAILED", f"{room}: too little for the results of a mission. Free space, or name another one ({key})"
        )
    if free_bytes < PLENTY_BYTES:
        return Finding(
            name, "warning", f"{room}: recordings of a day may fill it. Free space, or name another one ({key})"
        )
    return Finding(name, "ok", room)
