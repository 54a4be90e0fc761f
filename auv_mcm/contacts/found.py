"""What a mission has found so far, each contact as it was told last: on disk, until all of it is written at the end."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np

from auv_mcm.contacts.export import coverage_order
from auv_mcm.contacts.shelf import Shelf
from auv_mcm.records import Contact, CoveragePatch, contact_id, contact_number

_NOWHERE: Final = -1
_ID: Final = "S12"


class Found:
    """`contacts` and `coverage` come in the order in which they are written, one at a time, and may be gone through again and again."""

    def __init__(self, folder: Path) -> None:
        """folder: as for a shelf."""
        self._contacts = Shelf(folder, Contact)
        self._coverage = Shelf(folder, CoveragePatch)
        self._places = array("i")  # on the shelf, by number of the contact
        self._orders: list[tuple[int, str, float]] = []  # of patches

    def keep(self, contacts: Iterable[Contact] = (), coverage: Iterable[CoveragePatch] = ()) -> None:
        """Contacts that are new or take the place of what was told of them before, and further patches."""
        for contact in contacts:
            number = contact_number(contact.id)
            self._places.extend([_NOWHERE] * (number + 1 - len(self._places)))
            if self._places[number] == _NOWHERE:
                self._places[number] = len(self._contacts)
                self._contacts.append(contact)
            else:
                self._contacts[self._places[number]] = contact
        for patch in coverage:
            self._orders.append(coverage_order(patch))
            self._coverage.append(patch)

    @property
    def contacts(self) -> Iterable[Contact]:
        places = np.array(self._places)
        numbers = np.flatnonzero(places != _NOWHERE)
        # Ids are texts: C100000 comes before C10001. As bytes of one length they take a fraction of what strings do.
        ids = np.fromiter((contact_id(int(number)).encode("ascii") for number in numbers), dtype=_ID, count=len(numbers))
        return self._contacts.selected(places[numbers[np.argsort(ids, kind="stable")]])

    @property
    def coverage(self) -> Iterable[CoveragePatch]:
        return self._coverage.selected(sorted(range(len(self._orders)), key=self._orders.__getitem__))

    @property
    def n_in_memory(self) -> int:
        """Records that the disk did not take."""
        return self._contacts.n_in_memory + self._coverage.n_in_memory

    @property
    def n_unreadable(self) -> int:
        """Times the disk did not give a record back."""
        return self._contacts.n_unreadable + self._coverage.n_unreadable

    def close(self) -> None:
        """Give the disk space back. Nothing can be read any more."""
        self._contacts.close()
        self._coverage.close()
