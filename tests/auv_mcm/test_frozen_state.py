"""The state of the chain, frozen and thawed at any event, goes on to the same; and nothing else can be thawed."""

from __future__ import annotations

import os
import pickle
import random
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from auv_mcm.contacts.contact_store import ContactStore
from auv_mcm.contacts.record_file import RecordFile, packed
from auv_mcm.frozen_state import StateError, freeze, thaw
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import SourceEvent
from auv_mcm.shell.journal import Journal
from tests.auv_mcm.contacts.temporary_records import temporary_record_file
from tests.auv_mcm.test_pipeline_early import CONFIG, mission


def answers(events: Sequence[SourceEvent], cuts: set[int], folder: Path) -> list[bytes]:
    """All that a pipeline gives, packed; at each cut another one goes on where it was."""
    with closing(temporary_record_file(folder)) as file:
        return list(_answers(events, cuts, file))


def _answers(events: Sequence[SourceEvent], cuts: set[int], file: RecordFile) -> Iterator[bytes]:
    config, kept = CONFIG, ContactStore(file)
    pipeline = Pipeline(config, kept=kept, early=True)
    for number, event in enumerate(events):
        if number in cuts:
            state = {"pipeline": pipeline.state(), "contacts": kept.state()}
            data = freeze(state, {**pipeline.constants, "kept": kept})
            kept = ContactStore(file)
            pipeline = Pipeline(config, kept=kept, early=True)
            state = thaw(data, {**pipeline.constants, "kept": kept})
            pipeline.restore(state["pipeline"])
            kept.restore(state["contacts"])
        yield from map(packed, pipeline.feed(event))
    yield from map(packed, pipeline.finish())


def test_a_chain_that_is_frozen_and_thawed_on_the_way_gives_the_same_to_the_byte(tmp_path: Path) -> None:
    events = mission()
    cuts = set(random.Random(3).sample(range(len(events)), 8))
    disturbed = answers(events, cuts, tmp_path)
    assert disturbed == answers(events, set(), tmp_path)
    assert len(disturbed) > 4, "tiles and contacts"


class _Command:
    def __reduce__(self) -> tuple[object, ...]:
        return os.system, ("true",)


class _File:
    def __reduce__(self) -> tuple[object, ...]:
        return Journal, (Path("/nowhere/at/all"),)


@pytest.mark.parametrize("harmful", [_Command(), _File(), np.load, print])
def test_what_is_no_state_is_refused(harmful: object) -> None:
    with pytest.raises(StateError, match="no part of one"):
        thaw(pickle.dumps(harmful), {})


@pytest.mark.parametrize("data", [b"", b"no state", freeze([1, 2, 3], {})[:-3]])
def test_damaged_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(StateError):
        thaw(data, {})


def test_constants_stand_by_name() -> None:
    model, other = object(), Counter({"a": 1})
    assert thaw(freeze([other, model], {"model": model}), {"model": "another"}) == [other, "another"]
    with pytest.raises(StateError, match="'model'"):
        thaw(freeze([model], {"model": model}), {})
