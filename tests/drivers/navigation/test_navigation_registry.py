"""Check that every navigation protocol has a decoder by name, and that all of them keep the interface."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from auv_mcm.errors import UsageError
from drivers.navigation.nav_protocols import TEXT_PROTOCOLS, text_decoder
from sim_replay.fakes.framed_wires import WIRES, FramedWire
from tests.drivers.navigation.nav_damage import fed


@pytest.mark.parametrize("wire", [wire for wire in WIRES if wire.name in TEXT_PROTOCOLS], ids=lambda wire: wire.name)
@settings(max_examples=30)
@given(seed=st.integers(0, 99), junk=st.lists(st.binary(max_size=60), max_size=20), data=st.data())
def test_no_bytes_raise_or_hide_what_comes_later(
    wire: FramedWire, seed: int, junk: list[bytes], data: st.DataObject
) -> None:
    lines = wire.messages(np.random.Generator(np.random.PCG64(seed)), 30)
    unit = text_decoder(wire.name, "unit")
    fed(unit, data.draw(st.permutations([*junk, *(line[: data.draw(st.integers(1, len(line)))] for line in lines)])))
    assert {fix.source for fix in fed(unit, [b"\r\n", *lines])} == {"unit"}


def test_an_unknown_protocol_is_refused_with_the_known_ones() -> None:
    with pytest.raises(UsageError, match=r"'morse'.*nmea0183, pd6, water_linked, nmea2000"):
        text_decoder("morse", "unit")
