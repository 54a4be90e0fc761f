"""Write the pictures of contacts, `snippets/<id>.png`: all of a replay at once, or as a service finds them."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

from auv_mcm.errors import UsageError
from auv_mcm.safe_files import own_directory, replacing
from auv_mcm.shell.whole_files import make_directory

_SNIPPETS: Final = "snippets"
_SNIPPET_NAME: Final = re.compile(r"C[0-9]+\.png")


def write_snippets(folder: Path, pictures: Mapping[str, bytes]) -> None:
    """Write `snippets/<id>.png` for each contact id in `pictures`.

    Contacts' pictures of an earlier replay go, other files stay.

    Raises OSError, also for a link in the place of `snippets`.
    """
    with own_directory(folder / _SNIPPETS) as snippets:
        for contact_id, picture in pictures.items():
            _write_snippet(snippets, contact_id, picture)
        for name in os.listdir(snippets):
            if (
                _SNIPPET_NAME.fullmatch(name)
                and name.removesuffix(".png") not in pictures
                and stat.S_ISREG(os.stat(name, dir_fd=snippets, follow_symlinks=False).st_mode)
            ):
                os.unlink(name, dir_fd=snippets)


class Snippets:
    """Write `snippets/<id>.png` as pictures come; the last one of a contact stays."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder / _SNIPPETS
        self._owed: dict[str, bytes] = {}  # pictures that could not be written

    def write(self, pictures: Mapping[str, bytes] = MappingProxyType({})) -> None:
        """Write pictures. Raises OSError, as on a full disk; failed ones are tried again with the next."""
        self._owed |= pictures
        with own_directory(self._folder) as snippets:
            for contact_id, picture in list(self._owed.items()):
                _write_snippet(snippets, contact_id, picture)
                del self._owed[contact_id]


def _write_snippet(snippets: int, contact_id: str, picture: bytes) -> None:
    """Write one picture without waiting for the disk: there are thousands."""
    with replacing(Path(f"{contact_id}.png"), directory=snippets, durable=False) as file:
        file.write(picture)


def make_results_directory(path: Path) -> Path:
    """Make the directory of a replay's results, with `snippets/` in it.

    Raises UsageError if one of them cannot be written to.
    """
    make_directory(path)
    snippets = path / _SNIPPETS
    try:
        with own_directory(snippets):
            return path
    except OSError as error:
        raise UsageError(
            f"{snippets} is a link or cannot be opened: {error.strerror}. Remove it, or name another directory."
        ) from error
