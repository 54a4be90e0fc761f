"""Store the coverage of a mission: patches in an append-only file, without their cells.

The map of the search has taken the cells up.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import msgspec

from auv_mcm.contacts.export import coverage_order
from auv_mcm.contacts.placed_records import PlacedRecords, Selection
from auv_mcm.contacts.record_file import RecordFile, RecordPlace
from auv_mcm.records import CoveragePatch


class StoredPatch(NamedTuple):
    """Hold a patch that was written, or that the disk did not take.

    order: in which it is exported, see `coverage_order`.
    """

    order: tuple[int, str, float]
    patch: RecordPlace | CoveragePatch


def store_patch(file: RecordFile, patch: CoveragePatch) -> StoredPatch:
    """Write a patch and return its place; where the disk does not take it, the patch itself."""
    patch = msgspec.structs.replace(patch, cells=None)
    return StoredPatch(coverage_order(patch), file.append(patch) or patch)


class CoverageStore:
    """Hold the patches of a mission.

    Each is at its place in a file or, where the disk did not take it, packed in memory.
    """

    def __init__(self, file: RecordFile) -> None:
        self._patches = PlacedRecords(file, CoveragePatch)
        self._orders: list[tuple[int, str, float]] = []

    @property
    def n_in_memory(self) -> int:
        """Count the patches that the disk did not take."""
        return self._patches.n_in_memory

    def state(self) -> Any:
        """Give what it knows of where patches lie."""
        return self._patches.state(), self._orders

    def restore(self, state: Any) -> None:
        """Take the state of a store of the same file."""
        patches, self._orders = state
        self._patches.restore(patches)

    def keep(self, stored: StoredPatch) -> None:
        """Take a further patch."""
        self._patches.keep(len(self._orders), stored.patch)
        self._orders.append(stored.order)

    def in_order(self) -> Iterable[CoveragePatch]:
        """Iterate over all patches in the order in which they are exported; may be repeated."""
        return Selection(self._patches.__getitem__, sorted(range(len(self._orders)), key=self._orders.__getitem__))
