"""Check that every navigation protocol has a decoder by name, and that all of them keep the interface."""

from __future__ import annotations

import pytest

from auv_mcm.errors import UsageError
from drivers.navigation.nav_protocols import TEXT_PROTOCOLS, text_decoder
from tests.drivers.navigation.nav_damage import T0


@pytest.mark.parametrize("protocol", TEXT_PROTOCOLS)
def test_every_decoder_takes_anything_and_names_its_unit(protocol: str) -> None:
    decoder = text_decoder(protocol, "unit")
    assert [*decoder.feed(b"\x00$:w" * 50, T0), *decoder.finish()] == []
    assert sum(decoder.counters.values()) > 0


def test_an_unknown_protocol_is_refused_with_the_known_ones() -> None:
    with pytest.raises(UsageError, match=r"'morse'.*nmea0183, pd6, water_linked, nmea2000"):
        text_decoder("morse", "unit")
