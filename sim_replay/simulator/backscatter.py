"""Model how strongly a sea floor, or the surface of an object, echoes at each grazing angle.

The sea floor follows APL-UW TR 9407 (1994), Sec. IV.C: interface scattering, by the Kirchhoff approximation near normal
incidence, by the composite-roughness approximation elsewhere and by an empirical form for gravel and rock, plus
scattering from the sediment's volume. Its authors state some 3 dB of uncertainty for sand and silt above 5 degrees, 10
dB for rock.

The model was compared with data from 10 to 100 kHz. Beyond, the angular shape is the one at the nearer end of that
band, and only the level follows the frequency: as much as the model itself changes at 20 degrees grazing, the middle of
a side scan's swath. From 100 to 900 kHz that is 2 to 4 dB for rock and sand, whose roughness scatters more as the wave
gets shorter, and nothing for mud, whose volume scatters. Evaluating the full model there instead would make gravel of
every sand: it picks its branch by the slope at the scale of the wavelength.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf, gamma

Floats: TypeAlias = NDArray[np.float64]
Complexes: TypeAlias = NDArray[np.complex128]

TABLE_SIZE: Final = 4096  # entries over the sine of the grazing angle
LOWEST_HZ: Final = 10e3  # Hz: below, the angular shape is that of 10 kHz (data of APL-UW TR 9407)
HIGHEST_HZ: Final = 100e3  # Hz: above, that of 100 kHz
REFERENCE_SOUND_SPEED_MPS: Final = 1528.0  # of the report's own tables

_LEVEL_GRAZING_RAD: Final = math.radians(20.0)
_MIN_GRAZING_DEG: Final = 0.001  # the strength tends to -inf below
_KIRCHHOFF_MIN_DEG: Final = 40.0  # degrees of grazing, below which the Kirchhoff part does not count (APL-UW TR 9407)
_SLOW_BOTTOM_CRITICAL_DEG: Final = 2.5613  # degrees: the critical angle of a speed ratio of 1.001
_SLOPE_WEIGHTS: Final = (0.295410, 1.181636, 0.295410)  # Gauss-Hermite quadrature over the slopes of large scale
_SLOPE_NODES: Final = (1.224745, 0.0, -1.224745)  # standard deviations: three-point Gauss-Hermite
_LIMITS: Final = {  # recommended in Sec. IV.A.8; lower ends of loss and spectral_strength_cm4 excluded
    "density_ratio": (1.0, 3.0),
    "sound_speed_ratio": (0.8, 3.0),
    "loss": (0.0, 0.1),
    "volume_parameter": (0.0, 1.0),
    "spectral_strength_cm4": (0.0, 1.0),
    "spectral_exponent": (2.4, 3.9),
}


class Sediment(msgspec.Struct, frozen=True, kw_only=True):
    """Describe a sea floor to the backscatter model.

    density_ratio, sound_speed_ratio: sediment to water. loss: imaginary to real part of the sediment's wave number.
    volume_parameter: volume scattering cross section over attenuation. spectral_strength_cm4, spectral_exponent: the
    relief has the two-dimensional spectrum strength * K^-exponent, K in 1/cm. Raises ValueError outside the limits the
    report recommends.
    """

    density_ratio: float
    sound_speed_ratio: float
    loss: float
    volume_parameter: float
    spectral_strength_cm4: float
    spectral_exponent: float = 3.25

    def __post_init__(self) -> None:
        for name, (low, high) in _LIMITS.items():
            value = getattr(self, name)
            positive = value > 0.0 or name not in ("loss", "spectral_strength_cm4")
            if not (low <= value <= high and positive):
                above = "from" if positive else "above"
                raise ValueError(f"{name} of the sediment is {value}; it must be {above} {low} to {high}")


def sediment_from_grain_size(mean_grain_size_phi: float) -> Sediment:
    """Return the usual parameters of a sediment of this mean grain size (-log2 of the diameter in mm), Sec. IV.A.4.

    Raises ValueError unless it is from -1 (sandy gravel) to 9 (clay).
    """
    phi = float(mean_grain_size_phi)
    if not -1.0 <= phi <= 9.0:
        raise ValueError(f"mean_grain_size_phi is {phi}; it must be from -1 (sandy gravel) to 9 (clay)")
    if phi < 1.0:
        density = 0.007797 * phi**2 - 0.17057 * phi + 2.3139
        sound_speed = 0.002709 * phi**2 - 0.056452 * phi + 1.2778
    elif phi < 5.3:
        density = -0.0165406 * phi**3 + 0.2290201 * phi**2 - 1.1069031 * phi + 3.0455
        sound_speed = -0.0014881 * phi**3 + 0.0213937 * phi**2 - 0.1382798 * phi + 1.3425
    else:
        density = -0.0012973 * phi + 1.1565
        sound_speed = -0.0024324 * phi + 1.0019
    rms_relief_cm = (2.03846 - 0.26923 * phi) / (1.0 + 0.076923 * phi) if phi < 5.0 else 0.5
    return Sediment(
        density_ratio=density,
        sound_speed_ratio=sound_speed,
        loss=_attenuation_db_per_m_khz(phi)
        * sound_speed
        * 1e-3
        * REFERENCE_SOUND_SPEED_MPS
        * math.log(10.0)
        / (40.0 * math.pi),
        volume_parameter=0.002 if phi < 5.5 else 0.001,
        spectral_strength_cm4=0.00207 * rms_relief_cm**2,
    )


def _attenuation_db_per_m_khz(phi: float) -> float:
    if phi < 0.0:
        return 0.4556
    if phi < 2.6:
        return 0.4556 + 0.0245 * phi
    if phi < 4.5:
        return 0.1978 + 0.1245 * phi
    if phi < 6.0:
        return 8.0399 - 2.5228 * phi + 0.20098 * phi**2
    return 0.9431 - 0.2041 * phi + 0.0117 * phi**2


def _rock(sound_speed_ratio: float, spectral_strength_cm4: float) -> Sediment:
    return Sediment(
        density_ratio=2.5,
        sound_speed_ratio=sound_speed_ratio,
        loss=0.01374,
        volume_parameter=0.002,
        spectral_strength_cm4=spectral_strength_cm4,
    )


SEDIMENTS: Final[Mapping[str, Sediment]] = MappingProxyType(
    {
        "rough_rock": _rock(2.5, 0.20693),
        "rock": _rock(2.5, 0.01862),
        "cobble": _rock(1.8, 0.0156),
        "sandy_gravel": sediment_from_grain_size(-1.0),
        "coarse_sand": sediment_from_grain_size(0.5),
        "medium_sand": sediment_from_grain_size(1.5),
        "fine_sand": sediment_from_grain_size(2.5),
        "very_fine_sand": sediment_from_grain_size(3.5),
        "coarse_silt": sediment_from_grain_size(4.5),
        "medium_silt": sediment_from_grain_size(5.5),
        "clay": sediment_from_grain_size(9.0),
    }
)


def backscatter(
    sediment: Sediment,
    frequency_hz: float,
    grazing_rad: Floats | float,
    sound_speed_mps: float = REFERENCE_SOUND_SPEED_MPS,
) -> Floats:
    """Return the backscattering cross section per unit area and solid angle, linear.

    The scattering strength is 10 log10 of it.

    grazing_rad: any shape; angles below 0.001 degrees are taken as that, above 90 degrees as 90. Returns float64 of
    that shape. Raises ValueError if frequency or sound speed is not a positive number.
    """
    for name, value in (("frequency_hz", frequency_hz), ("sound_speed_mps", sound_speed_mps)):
        if not 0.0 < value < math.inf:
            raise ValueError(f"{name} is {value}; it must be a positive number")
    frequency_of_shape_hz = min(max(frequency_hz, LOWEST_HZ), HIGHEST_HZ)
    sigma = _cross_section(sediment, frequency_of_shape_hz / sound_speed_mps, np.asarray(grazing_rad, dtype=np.float64))
    if frequency_of_shape_hz != frequency_hz:
        middle = np.array(_LEVEL_GRAZING_RAD)
        at_frequency = _cross_section(sediment, frequency_hz / sound_speed_mps, middle)
        sigma *= at_frequency / _cross_section(sediment, frequency_of_shape_hz / sound_speed_mps, middle)
    return sigma


def lambert(grazing_rad: Floats | float, strength_db: float) -> Floats:
    """Return Lambert's law, 10^(strength/10) sin^2 of the grazing angle, linear.

    strength_db: the strength at normal incidence.
    """
    return np.asarray(10.0 ** (strength_db / 10.0) * np.sin(grazing_rad) ** 2)


def lookup_table(
    sediment: Sediment, frequency_hz: float, sound_speed_mps: float = REFERENCE_SOUND_SPEED_MPS
) -> NDArray[np.float32]:
    """Tabulate `backscatter` at evenly spaced sines of the grazing angle, for lookup without interpolation.

    Returns (TABLE_SIZE,) float32: entry k holds the value at sin g = (k + 0.5) / TABLE_SIZE and serves k <= TABLE_SIZE
    sin g < k + 1; sin g = 1 belongs to the last entry. Within 0.1 dB of backscatter from 3 to 80 degrees from 100 kHz
    up; closer to normal incidence an entry spans degrees, over which the peak of smooth mud varies by more. Raises
    ValueError as backscatter does.
    """
    return backscatter(sediment, frequency_hz, np.arcsin(_table_sines()), sound_speed_mps).astype(np.float32)


def target_table(strength_db: float, specular_gain_db: float, specular_exponent: float) -> NDArray[np.float32]:
    """Tabulate man-made surfaces as lookup_table does: Lambert's law and a lobe around normal incidence.

    The cross section is 10^(strength/10) (sin^2 g + 10^(gain/10) sin^exponent g), g being the grazing angle on the
    surface itself. A gain of -inf leaves the lobe out; an exponent of 20 to 60 is usual for smooth shells. Raises
    ValueError unless the exponent is positive and strength and gain are at most 100 dB.
    """
    if not (0.0 < specular_exponent < math.inf and strength_db <= 100.0 and specular_gain_db <= 100.0):
        raise ValueError(
            f"strength_db is {strength_db}, specular_gain_db {specular_gain_db}, specular_exponent "
            f"{specular_exponent}: the exponent must be positive, the others at most 100 dB"
        )
    sines = _table_sines()
    sigma = lambert(np.arcsin(sines), strength_db)
    lobe: Floats = 10.0 ** ((strength_db + specular_gain_db) / 10.0) * sines**specular_exponent
    return (sigma + lobe).astype(np.float32)


def _table_sines() -> Floats:
    return (np.arange(TABLE_SIZE) + 0.5) / TABLE_SIZE


def _cross_section(sediment: Sediment, waves_per_m: float, grazing_rad: Floats) -> Floats:
    """Evaluate the report's model; `waves_per_m` is frequency over sound speed in water."""
    wavenumber = 0.02 * math.pi * waves_per_m  # per cm, as the relief spectrum has it
    alpha = sediment.spectral_exponent / 2.0 - 1.0
    grazing_deg = np.clip(np.degrees(grazing_rad), _MIN_GRAZING_DEG, 90.0)
    rms_slope = math.sqrt(
        (2.0 * math.pi * sediment.spectral_strength_cm4) ** (1.0 / alpha)
        / (2.0 * (1.0 - alpha))
        * (wavenumber**2 / alpha) ** ((1.0 - alpha) / alpha)
    )
    shadowing = _shadowing(grazing_deg, rms_slope)
    composite = np.zeros_like(grazing_deg)
    volume = np.zeros_like(grazing_deg)
    for weight, node in zip(_SLOPE_WEIGHTS, _SLOPE_NODES, strict=True):
        local_rad = np.radians(np.clip(grazing_deg - node * math.degrees(rms_slope), 0.0, 90.0))
        composite += weight / math.sqrt(math.pi) * _small_roughness(sediment, wavenumber, local_rad)
        volume += weight / math.sqrt(math.pi) * _volume(sediment, local_rad)

    kirchhoff, kirchhoff_until_cosine = _kirchhoff(sediment, wavenumber, alpha, grazing_deg)
    share = _falling((np.cos(np.radians(grazing_deg)) - kirchhoff_until_cosine) / 0.0125)
    moderate = share * kirchhoff + (1.0 - share) * shadowing * composite
    smooth = _falling((math.degrees(math.atan(rms_slope)) - 7.0) / 0.5)
    interface = smooth * moderate + (1.0 - smooth) * _large_roughness(sediment, rms_slope, grazing_deg)
    return np.asarray(interface + shadowing * volume)


def _kirchhoff(sediment: Sediment, wavenumber: float, alpha: float, grazing_deg: Floats) -> tuple[Floats, float]:
    """Return the Kirchhoff approximation and the cosine of the grazing angle down to which it applies."""
    structure = (
        2.0
        * math.pi
        * sediment.spectral_strength_cm4
        * gamma(2.0 - alpha)
        * 2.0 ** (-2.0 * alpha)
        / (alpha * (1.0 - alpha) * gamma(1.0 + alpha))
    )
    q = structure * 2.0 ** (1.0 - 2.0 * alpha) * wavenumber ** (2.0 * (1.0 - alpha))
    half_over_alpha = 1.0 / (2.0 * alpha)
    a = (
        8.0 * alpha**2 * gamma(half_over_alpha + 0.5) / (gamma(0.5) * gamma(1.0 / alpha) * gamma(half_over_alpha))
    ) ** (2.0 * alpha)
    b = a ** (0.5 - half_over_alpha) * gamma(1.0 / alpha) * half_over_alpha
    # The equations as printed are 3.56 dB below the report's own Table 3 wherever this approximation governs; this
    # factor makes up for it.
    level = 2.0 ** (2.0 * (1.0 - alpha) / alpha)
    grazing_rad = np.radians(grazing_deg)
    spread = np.cos(grazing_rad) ** (4.0 * alpha) + a * q**2 * np.sin(grazing_rad) ** 4
    sigma = level * b * q * _normal_reflection(sediment) / (8.0 * math.pi * spread ** ((1.0 + alpha) * half_over_alpha))
    c4 = 1000.0 ** (1.0 / (1.0 + alpha)) * (a * q**2) ** (1.0 / alpha)
    return np.where(grazing_deg >= _KIRCHHOFF_MIN_DEG, sigma, 0.0), float((c4 / (1.0 + 4.0 * c4)) ** 0.25)


def _small_roughness(sediment: Sediment, wavenumber: float, grazing_rad: Floats) -> Floats:
    """Return perturbation theory's value for a horizontal interface."""
    cosine, sine = np.cos(grazing_rad), np.sin(grazing_rad)
    kappa, vertical = _refraction(sediment, cosine)
    density = sediment.density_ratio
    contrast = ((density - 1.0) ** 2 * cosine**2 + density**2 - kappa**2) / (density * sine + vertical) ** 2
    bragg = np.sqrt(4.0 * wavenumber**2 * cosine**2 + (wavenumber / 10.0) ** 2)
    relief = sediment.spectral_strength_cm4 * bragg**-sediment.spectral_exponent
    return np.asarray(4.0 * wavenumber**4 * sine**4 * np.abs(contrast) ** 2 * relief)


def _volume(sediment: Sediment, grazing_rad: Floats) -> Floats:
    """Return 5 loss volume_parameter |1 - R^2|^2 sin^2 / (sound_speed_ratio ln10 |P|^2 Im P), arranged so P may be
    0."""
    sine = np.sin(grazing_rad)
    _, vertical = _refraction(sediment, np.cos(grazing_rad))
    density = sediment.density_ratio
    transmitted = 16.0 * density**2 * sine**4 / np.abs(density * sine + vertical) ** 4
    return np.asarray(
        5.0
        * sediment.loss
        * sediment.volume_parameter
        * transmitted
        / (sediment.sound_speed_ratio * math.log(10.0) * vertical.imag)
    )


def _refraction(sediment: Sediment, cosine: Floats) -> tuple[complex, Complexes]:
    """Compute the wave number in the sediment and its vertical component P, over the wave number in water.

    Im P > 0, as the loss is positive.
    """
    kappa = complex(1.0, sediment.loss) / sediment.sound_speed_ratio
    return kappa, np.sqrt(kappa**2 - cosine**2)


def _normal_reflection(sediment: Sediment) -> float:
    """Return the power reflected at normal incidence."""
    kappa, density = complex(1.0, sediment.loss) / sediment.sound_speed_ratio, sediment.density_ratio
    return abs((density - kappa) / (density + kappa)) ** 2


def _shadowing(grazing_deg: Floats, rms_slope: float) -> Floats:
    """Return the share of the interface that its own large-scale slopes leave in view."""
    ratio = np.minimum(np.tan(np.radians(grazing_deg)) / rms_slope, 2.0)
    hidden = (np.exp(-(ratio**2)) / math.sqrt(math.pi) - ratio * (1.0 - erf(ratio))) / (4.0 * ratio)
    return np.asarray(np.where(ratio < 2.0, -np.expm1(-2.0 * hidden) / (2.0 * hidden), 1.0))


def _large_roughness(sediment: Sediment, rms_slope: float, grazing_deg: Floats) -> Floats:
    """Return the empirical form for gravel and rock."""
    speed, slope_deg = sediment.sound_speed_ratio, math.degrees(rms_slope)
    critical_deg = math.degrees(math.acos(1.0 / speed)) if speed >= 1.001 else _SLOW_BOTTOM_CRITICAL_DEG
    ramp = 1.0 + 0.81 * critical_deg**2 / grazing_deg**2
    oblique = 0.04682 * rms_slope**1.25 * speed**3.25 * ((1.0 - 2.0 / sediment.density_ratio) / speed**2 + 1.0) ** 2
    oblique /= 1.0 + 3.54 * slope_deg / critical_deg
    steep = (
        0.026
        * _normal_reflection(sediment)
        / (rms_slope**2 * (1.0 + (grazing_deg - 90.0) ** 2 / (2.6 * slope_deg**2)) ** 1.9 * ramp)
    )
    return np.asarray(oblique * np.sin(math.pi / ramp) ** (0.7263 * rms_slope ** (-1.0 / 3.0)) + steep)


def _falling(value: Floats | float) -> Floats:
    """Fall smoothly from 1 far below zero to 0 far above."""
    return np.asarray(1.0 / (1.0 + np.exp(np.clip(value, -40.0, 40.0))))
