"""Store the contacts of a mission in an append-only file.

Each view is stored once, each version of a contact as a head with its views' places.

Perception writes. The service knows each contact by the place of its newest version, and reads.

What bounds the file: a view is written once and takes several kB, mostly pictures; a head takes less than 0.7 kB and 40
bytes per view. There is one head per view, for a contact changes with each. So the heads of old versions, all in the
file that is of no more use, are a tenth or so of it.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from typing import Any, Final

import msgspec
import numpy as np

from auv_mcm.contacts.placed_records import PlacedRecords, Selection
from auv_mcm.contacts.record_file import RecordFile, RecordPlace, record_decoder
from auv_mcm.records import Contact, Detection, contact_id, contact_number

_ID: Final = "S12"  # numpy's kind for ids, with room for eleven digits


class _Version(msgspec.Struct, frozen=True, array_like=True):
    """Hold a version of a contact: its head with its views' places or, in memory, with its views and no places."""

    head: Contact
    views: tuple[RecordPlace, ...]


class ContactStore:
    """Keep contacts by the number in their id, each as it was when it last changed.

    No method raises for a disk that is full or gone.

    file: takes the records; a contact that it does not take is held in memory, packed.
    """

    def __init__(self, file: RecordFile) -> None:
        self._file = file
        self._versions = PlacedRecords(file, _Version)
        self._view_decoder = record_decoder(Detection)

    @property
    def n_in_memory(self) -> int:
        """Count the contacts that the disk did not take."""
        return self._versions.n_in_memory

    def state(self) -> Any:
        """Give what it knows of where contacts lie."""
        return self._versions.state()

    def restore(self, state: Any, numbers: Container[int] | None = None) -> None:
        """Take the state of a store of the same file. numbers: of the contacts to know, None for all."""
        self._versions.restore(state, numbers)

    def add(self, contact: Contact) -> None:
        """Write a contact with all its views. Raises ValueError for an id that is not C and a number."""
        self._write(contact, [None] * len(contact.views))

    def add_view(self, contact: Contact, view: Detection) -> None:
        """Write a version of a contact that has one view more than the one before.

        view: the new one, itself among the contact's views.
        """
        known = self._view_places(contact_number(contact.id))
        if len(known) != len(contact.views) - 1:
            self.add(contact)  # the version before is in memory, or cannot be read
            return
        at = next(index for index, other in enumerate(contact.views) if other is view)
        self._write(contact, [*known[:at], None, *known[at:]])

    def keep(self, contact: Contact, place: RecordPlace | None) -> None:
        """Take a version that another process wrote.

        Its place or, if there is none, the contact itself, to be held in memory.

        Raises ValueError for an id that is not C and a number.
        """
        self._versions.keep(contact_number(contact.id), _Version(contact, ()) if place is None else place)

    def __contains__(self, number: int) -> bool:
        return number in self._versions

    def place(self, number: int) -> RecordPlace | None:
        """Return where the newest version of a contact lies; None for one that is in memory or not known."""
        return self._versions.place(number)

    def __getitem__(self, number: int) -> Contact:
        """Read a contact; its arrays cannot be written to.

        Raises OSError if the disk does not give it back, KeyError without it.
        """
        version = self._versions[number]
        if not version.views:
            return version.head
        views = tuple(self._file.read(place, self._view_decoder) for place in version.views)
        return msgspec.structs.replace(version.head, views=views)

    def unreadable(self) -> list[int]:
        """List the numbers of contacts that are known and that the disk does not give back."""
        unreadable = []
        for number in self._versions.numbers().tolist():
            try:
                self[number]
            except OSError:
                unreadable.append(number)
        return unreadable

    def in_order(self) -> Iterable[Contact]:
        """Iterate over all contacts in the order in which they are exported; may be repeated."""
        numbers = self._versions.numbers()
        # Ids are texts: C100000 comes before C10001. As bytes of one length they take a fraction of what strings do.
        ids = np.fromiter(
            (contact_id(int(number)).encode("ascii") for number in numbers), dtype=_ID, count=len(numbers)
        )
        return Selection(self.__getitem__, numbers[np.argsort(ids, kind="stable")])

    def _view_places(self, number: int) -> Sequence[RecordPlace]:
        """Read where the views of a contact lie; empty for one that is in memory or cannot be read."""
        try:
            return self._versions[number].views
        except OSError:
            return ()

    def _write(self, contact: Contact, places: Sequence[RecordPlace | None]) -> None:
        """Append what is not in the file yet; hold all of the contact in memory where that does not take it.

        places: of the contact's views, None for those that are to be written.
        """
        before = self._file.end
        written = [place or self._file.append(view) for place, view in zip(places, contact.views, strict=True)]
        in_file = tuple(place for place in written if place is not None)
        place = None
        if len(in_file) == len(written):
            place = self._file.append(_Version(msgspec.structs.replace(contact, views=()), in_file))
        if place is None:
            self._file.take_back(before)
        self.keep(contact, place)
