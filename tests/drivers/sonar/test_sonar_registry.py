"""Check that every sonar is found by its name."""

from __future__ import annotations

import pytest

from auv_mcm.errors import UsageError
from auv_mcm.settings.config import SonarConfig
from drivers.sonar.sonar_decoder import SonarSettings
from drivers.sonar.sonars import SONARS, sonar_named
from tests.drivers.sonar.sonar_frames import NOW


def test_an_unknown_sonar_is_refused_with_those_that_are_known() -> None:
    with pytest.raises(UsageError, match=r"unknown sonar 'klein'\. Known: ping_protocol, jsf, sportscan"):
        sonar_named("klein")


@pytest.mark.parametrize("name", SONARS)
def test_every_sonar_decodes_and_takes_settings(name: str) -> None:
    device = sonar_named(name)
    decoder = device.decoder(SonarConfig())
    assert [*decoder.feed(bytes(range(256)) * 20, NOW), *decoder.finish()] == []
    assert decoder.counters[f"{name}.bytes_skipped"] == 5120
    sent = device.commands(SonarSettings(range_m=60.0, gain=3))
    assert sent
    assert all(isinstance(command, bytes) for command in sent)
    changed = {
        "range": device.commands(SonarSettings(range_m=30.0, gain=3)) != sent,
        "gain": device.commands(SonarSettings(range_m=60.0, gain=4)) != sent,
        "enable": device.commands(SonarSettings(range_m=60.0, gain=3, enabled=False)) != sent,
    }
    assert changed == {"range": device.sets_range, "gain": device.sets_gain, "enable": device.sets_enable}
