"""What depends on slant range or angle alone, against other models and definitions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from sim_replay.simulator.backscatter import SEDIMENTS, TABLE_SIZE, lookup_table
from sim_replay.simulator.echo import (
    absorption_db_per_km,
    beam_table,
    bin_ranges_m,
    flat_floor_intensity,
    floor_tables,
    material_tables,
    propagation,
    recorder_gain,
    vertical_pattern,
)
from sim_replay.simulator.objects import Material
from sim_replay.simulator.scene import Lawnmower, Scene, Seabed, Sonar, TimeVariedGain, Track, World
from sim_replay.simulator.seabeds import cover_of

SINES = (np.arange(TABLE_SIZE) + 0.5) / TABLE_SIZE


def francois_garrison_db_per_km(f: float, depth_m: float) -> float:
    """At 10 degrees C, 35 PSU, pH 8 (J. Acoust. Soc. Am. 72, 1982); f in kHz."""
    temperature, salinity = 10.0, 35.0
    kelvin, c = 273.0 + temperature, 1412.0 + 3.21 * temperature + 1.19 * salinity + 0.0167 * depth_m
    boron = 2.8 * math.sqrt(salinity / 35.0) * 10.0 ** (4.0 - 1245.0 / kelvin)
    magnesium = 8.17 * 10.0 ** (8.0 - 1990.0 / kelvin) / (1.0 + 0.0018 * (salinity - 35.0))
    by_boron = 8.86 / c * 10.0**1.24 * boron * f**2 / (f**2 + boron**2)
    by_magnesium = 21.44 * salinity / c * (1.0 + 0.025 * temperature) * (1.0 - 1.37e-4 * depth_m + 6.2e-9 * depth_m**2)
    by_magnesium *= magnesium * f**2 / (f**2 + magnesium**2)
    water = 4.937e-4 - 2.59e-5 * temperature + 9.11e-7 * temperature**2 - 1.5e-8 * temperature**3
    by_water = water * (1.0 - 3.83e-5 * depth_m + 4.9e-10 * depth_m**2) * f**2
    return float(by_boron + by_magnesium + by_water)


@pytest.mark.parametrize("frequency_khz", [30.0, 100.0, 300.0, 450.0, 900.0])
@pytest.mark.parametrize("depth_m", [10.0, 300.0, 1000.0])
def test_absorption_is_that_of_sea_water(frequency_khz: float, depth_m: float) -> None:
    found = absorption_db_per_km(Sonar(frequency_khz=frequency_khz), depth_m)
    assert found == pytest.approx(francois_garrison_db_per_km(frequency_khz, depth_m), rel=0.08)


def test_absorption_that_the_scene_gives_is_taken() -> None:
    assert absorption_db_per_km(Sonar(absorption_db_per_km=7.5), 20.0) == 7.5


@given(width_deg=st.floats(5.0, 180.0))
def test_the_beam_has_half_power_at_half_its_width(width_deg: float) -> None:
    half = math.sin(math.radians(0.5 * width_deg))
    np.testing.assert_allclose(vertical_pattern(np.array([0.0, half, -half]), width_deg), [1.0, 0.5, 0.5], rtol=1e-5)
    table = beam_table(width_deg).astype(np.float64)
    np.testing.assert_allclose(table, table[::-1], atol=1e-7)
    assert table[int((1.0 + 0.999 * half) * 0.5 * TABLE_SIZE)] == pytest.approx(0.5, abs=0.02)


def test_floors_scatter_as_their_sediment_and_lambert_agrees_at_20_degrees() -> None:
    covers = cover_of(Seabed(type="sand")), cover_of(Seabed(type="gravel", level_db=3.0))
    scene = Scene(track=Track(plan=Lawnmower()))
    measured = floor_tables(scene, covers)
    expected = lookup_table(SEDIMENTS["sandy_gravel"], 450e3, 1500.0) * np.float32(10.0**0.3)
    np.testing.assert_allclose(measured[1], expected, rtol=1e-6)
    lambert = floor_tables(replace(scene, world=World(backscatter="lambert")), covers)
    at = int(math.sin(math.radians(20.0)) * TABLE_SIZE)
    np.testing.assert_allclose(lambert[:, at], measured[:, at], rtol=1e-3)
    np.testing.assert_allclose(lambert / lambert[:, -1:], np.broadcast_to(SINES**2, lambert.shape), rtol=1e-3)


def test_materials_have_their_strength_at_normal_incidence() -> None:
    assert material_tables([]).shape == (0, TABLE_SIZE)
    dull, shiny = material_tables([Material(-12.0, -math.inf, 40.0), Material(-12.0, 10.0, 40.0)])
    assert dull[-1] == pytest.approx(10.0**-1.2, rel=1e-3)
    assert shiny[-1] == pytest.approx(10.0**-1.2 * 11.0, rel=1e-2)
    np.testing.assert_allclose(shiny[: TABLE_SIZE // 2], dull[: TABLE_SIZE // 2], rtol=1e-4)


@given(
    spreading_db=st.floats(0.0, 60.0),
    absorption=st.floats(0.0, 300.0),
    made_up=st.one_of(st.none(), st.floats(0.0, 300.0)),
)
def test_the_gain_compensates_the_configured_losses(
    spreading_db: float, absorption: float, made_up: float | None
) -> None:
    sonar = Sonar(gain=TimeVariedGain(spreading_db=spreading_db, absorption_db_per_km=made_up))
    r, reference_m = bin_ranges_m(sonar), 25.0
    gain_db = 10.0 * np.log10(recorder_gain(r, sonar, absorption, reference_m))
    reported = absorption if made_up is None else made_up
    np.testing.assert_allclose(
        gain_db, spreading_db * np.log10(r / reference_m) + 2e-3 * reported * (r - reference_m), atol=1e-9
    )


def test_a_gain_of_40_db_and_the_waters_absorption_undo_propagation() -> None:
    sonar = Sonar(gain=TimeVariedGain(spreading_db=40.0))
    r = bin_ranges_m(sonar)
    level = recorder_gain(r, sonar, 110.0, 25.0) * propagation(r, 110.0)
    np.testing.assert_allclose(level, level[0], rtol=1e-9)


def test_a_flat_floor_echoes_all_of_its_ground_from_the_first_return_on() -> None:
    """Without beam and scattering law, intensity over spreading and width adds up to metres of ground."""
    sonar = Sonar(vertical_beam_width_deg=180.0, beam_width_deg=1.0)
    r, altitude_m = bin_ranges_m(sonar), 6.0
    echo = flat_floor_intensity(r, altitude_m, np.ones(TABLE_SIZE, dtype=np.float32), sonar, 0.0)
    at = np.maximum(r, altitude_m)
    tilt, depression = math.radians(sonar.tilt_deg), np.arcsin(altitude_m / at)
    ground = echo / (vertical_pattern(np.sin(depression - tilt), 180.0) * math.radians(1.0) * at * at**-4.0)
    assert ground.sum() == pytest.approx(math.sqrt(50.0**2 - 6.0**2), rel=1e-6)
    assert np.all(echo[r < altitude_m - 0.05] == 0.0)
