"""Compute the sonar equation apart from the rays: what depends on slant range or angle alone.

And echoes that do not come from the floor below.

Received intensity of a bin at slant range r, for a source of unit strength:

    I(r) = sum of sigma B^2 dA over the bin's facets * 10^(-2 a r / 10) / r^4,   dA = r theta_h * length along the ray

with the two-way beam pattern B^2, the horizontal beam width theta_h and the absorption a (Urick, Principles of
Underwater Sound, ch. 2, 8).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sim_replay.simulator.backscatter import SEDIMENTS, TABLE_SIZE, lambert, lookup_table, target_table
from sim_replay.simulator.objects import Material
from sim_replay.simulator.scene import Scene, Sonar, World
from sim_replay.simulator.seabeds import Cover

Floats = NDArray[np.float64]

_HALF_POWER: Final = 1.0019127  # sinc^4 is one half there
_LAMBERT_GRAZING_RAD: Final = math.radians(20.0)


def absorption_db_per_km(sonar: Sonar, depth_m: float) -> float:
    """Return the scene's absorption, or sea water's.

    The latter is at 10 degrees C, 35 PSU, pH 8 (Ainslie and McColm, JASA 103, 1998).
    """
    if sonar.absorption_db_per_km is not None:
        return sonar.absorption_db_per_km
    f, temperature, salinity, depth_km = sonar.frequency_khz, 10.0, 35.0, 1e-3 * depth_m
    boron = 0.78 * math.sqrt(salinity / 35.0) * math.exp(temperature / 26.0)
    magnesium = 42.0 * math.exp(temperature / 17.0)
    magnesium_share = magnesium * f * f / (magnesium * magnesium + f * f) * math.exp(-depth_km / 6.0)
    return (
        0.106 * boron * f * f / (boron * boron + f * f)
        + 0.52 * (1.0 + temperature / 43.0) * (salinity / 35.0) * magnesium_share
        + 0.00049 * f * f * math.exp(-(temperature / 27.0 + depth_km / 17.0))
    )


def beam_table(vertical_width_deg: float) -> NDArray[np.float32]:
    """Tabulate the two-way vertical power pattern sinc^4, (4096,) over the sine of the angle off the axis, -1 to 1."""
    sine = np.linspace(-1.0, 1.0, TABLE_SIZE, endpoint=False, dtype=np.float64) + 1.0 / TABLE_SIZE
    return vertical_pattern(sine, vertical_width_deg).astype(np.float32)


def vertical_pattern(sine: Floats, width_deg: float) -> Floats:
    """Return the pattern at any sine; half power at half the width."""
    phase = _HALF_POWER / math.sin(math.radians(0.5 * width_deg)) * sine
    return np.asarray(np.sinc(phase / math.pi) ** 4)


def floor_tables(scene: Scene, covers: tuple[Cover, ...]) -> NDArray[np.float32]:
    """Tabulate each floor's backscattering cross section per unit area, (n_covers, 4096) over the sine of grazing."""
    return np.stack([_floor_table(scene.world, scene.sonar, cover) for cover in covers])


def _floor_table(world: World, sonar: Sonar, cover: Cover) -> NDArray[np.float32]:
    table = lookup_table(SEDIMENTS[cover.sediment], 1e3 * sonar.frequency_khz, sonar.sound_speed_mps)
    if world.backscatter == "lambert":
        sine = (np.arange(TABLE_SIZE) + 0.5) / TABLE_SIZE
        strength = float(table[int(math.sin(_LAMBERT_GRAZING_RAD) * TABLE_SIZE)]) / math.sin(_LAMBERT_GRAZING_RAD) ** 2
        table = lambert(np.arcsin(sine), 10.0 * math.log10(strength)).astype(np.float32)
    return table * np.float32(10.0 ** (0.1 * cover.level_db))


def material_tables(materials: list[Material]) -> NDArray[np.float32]:
    """Tabulate the same for the materials of bodies, (n_materials, 4096)."""
    tables = [
        target_table(material.strength_db, material.specular_db, material.specular_exponent) for material in materials
    ]
    return np.stack(tables) if tables else np.empty((0, TABLE_SIZE), dtype=np.float32)


def bin_ranges_m(sonar: Sonar) -> Floats:
    """Return the slant range of the middle of every bin, (n_samples,)."""
    return np.asarray((np.arange(sonar.n_samples) + 0.5) * (sonar.range_m / sonar.n_samples), dtype=np.float64)


def propagation(slant_range_m: Floats, absorption: float) -> Floats:
    """Return two-way spreading and absorption, r^-4 10^(-2 a r / 10); absorption in dB/km."""
    return np.asarray(slant_range_m**-4.0 * 10.0 ** (-2e-4 * absorption * slant_range_m))


def flat_floor_intensity(
    slant_range_m: Floats, altitude_m: Floats | float, table: NDArray[np.float32], sonar: Sonar, absorption: float
) -> Floats:
    """Return the mean echo of a flat, even floor at slant ranges, per bin; 0 before the first bottom return.

    altitude_m broadcasts against it.
    """
    r = np.maximum(slant_range_m, altitude_m)
    sine = altitude_m / r
    cosine = np.sqrt((r - altitude_m) * (r + altitude_m)) / r
    bin_m = sonar.range_m / sonar.n_samples
    # A bin at the first return spans more floor than its middle's cosine gives: count it by its ends.
    far = np.sqrt(np.maximum((slant_range_m + 0.5 * bin_m) ** 2 - np.square(altitude_m), 0.0))
    near = np.sqrt(np.maximum((slant_range_m - 0.5 * bin_m) ** 2 - np.square(altitude_m), 0.0))
    tilt = math.radians(sonar.tilt_deg)
    pattern = vertical_pattern(
        np.asarray(sine * math.cos(tilt) - cosine * math.sin(tilt)), sonar.vertical_beam_width_deg
    )
    strength: Floats = table.astype(np.float64)[np.minimum((sine * TABLE_SIZE).astype(np.int64), TABLE_SIZE - 1)]
    width = math.radians(sonar.beam_width_deg) * r
    return np.asarray(strength * pattern * width * (far - near) * propagation(r, absorption))


def recorder_gain(slant_range_m: Floats, sonar: Sonar, absorption: float, reference_m: float) -> Floats:
    """Return the recorder's time-varied gain (power), 1 at reference_m."""
    made_up = absorption if sonar.gain.absorption_db_per_km is None else sonar.gain.absorption_db_per_km
    ratio = slant_range_m / reference_m
    return np.asarray(
        ratio ** (0.1 * sonar.gain.spreading_db) * 10.0 ** (2e-4 * made_up * (slant_range_m - reference_m))
    )
