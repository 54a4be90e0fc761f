"""Point to the last session in a folder, and find it, also where the file system has no links, as FAT has none."""

from __future__ import annotations

import logging
import os
import secrets
from pathlib import Path
from typing import Final

LATEST: Final = "latest"  # the link
SESSION: Final = "session-"  # how the name of a session's folder begins, with the time of its start behind
_FOLDERS: Final = f"{SESSION}????????T??????Z/"  # folders of sessions, not archives or copies beside them

log = logging.getLogger(__name__)


def point_latest_to(folder: Path) -> None:
    """Point to a new session. A link that cannot be made, or something else of that name, is only logged."""
    link, latest = folder.with_name(f".{secrets.token_hex(8)}.new"), folder.with_name(LATEST)
    if os.path.lexists(latest) and not latest.is_symlink():
        log.warning("no link 'latest' in %s: something else of that name is there. Move it away.", folder.parent)
        return
    try:
        link.symlink_to(folder.name)
        os.replace(link, latest)
    except OSError as error:
        link.unlink(missing_ok=True)
        log.warning("no link 'latest' in %s: %s", folder.parent, error.strerror)


def latest_session(parent: Path) -> Path:
    """Find the last session: the one that the link points to, or without a link the one whose name is the latest.

    Returns where the link would be if there is none. Raises OSError for a link or a folder that cannot be read.
    """
    if (parent / LATEST).is_symlink():
        return parent / os.readlink(parent / LATEST)
    return max(parent.glob(_FOLDERS), default=parent / LATEST)
