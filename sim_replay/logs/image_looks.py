"""Form looks from a complex image: intensities of parts of its Doppler spectrum.

Along the track the spectrum of a focused image holds one bearing per frequency, so that a part of it is the image of a
part of the aperture: coarser by as much, seen at another squint, with speckle of its own (Franceschetti and Lanari,
"Synthetic Aperture Radar Processing", 1999, section 4.4).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

OVERLAP_LINES: Final = 128  # read beyond a block on either side: a look's response is below -40 dB there
_TAPER: Final = 0.25  # of a part's width over which its edges fall: bounds side lobes at the cost of a fifth of it


def doppler_centroid(image: NDArray[Any]) -> float:
    """Measure the middle of the Doppler spectrum, in cycles per line from -0.5 to 0.5.

    By the phase from line to line (Madsen, IEEE Trans. Aerospace Electr. Sys. 25, 1989). image: (n_lines, n_pixels)
    complex.
    """
    products = image[1:] * np.conj(image[:-1])
    total = complex(products[np.isfinite(products)].sum())
    return math.atan2(total.imag, total.real) / math.tau


def sub_band(image: NDArray[Any], n: int, part: int, centroid: float, band: float) -> NDArray[np.float32]:
    """Form the intensity of one of n equal parts of the spectrum; see `sub_bands`, which counts them alike."""
    return next(sub_bands(image, n, centroid, band, part))


def sub_bands(
    image: NDArray[Any], n: int, centroid: float, band: float, first: int = 0
) -> Iterator[NDArray[np.float32]]:
    """Yield the intensity of equal parts of the spectrum, lowest frequency first, (n_lines, n_pixels).

    It is parted into n, of which those before `first` are left out.

    band: share of the sampled spectrum that the aperture fills, 0 to 1. Pixels that are not finite count as zero and
    come out as NaN. Sound beyond OVERLAP_LINES from either end of a longer image.
    """
    finite = np.isfinite(image)
    n_lines = image.shape[0]
    n_padded = n_lines + OVERLAP_LINES  # one end must not run into the other
    spectrum = np.fft.fft(np.where(finite, image, 0.0), n_padded, axis=0)
    frequency = (np.fft.fftfreq(n_padded) - centroid + 0.5) % 1.0 - 0.5
    width = band / n
    for part in range(first, n):
        middle = (part + 0.5) * width - 0.5 * band
        off = np.abs((frequency - middle + 0.5) % 1.0 - 0.5) / width
        weight = np.clip((0.5 * (1.0 + _TAPER) - off) / _TAPER, 0.0, 1.0)
        weight = np.sqrt(n) * np.sin(0.5 * math.pi * weight)
        looked = np.fft.ifft(spectrum * weight[:, np.newaxis], axis=0)[:n_lines]
        intensity = (looked.real**2 + looked.imag**2).astype(np.float32)
        yield np.where(finite, intensity, np.float32(np.nan))


def mean_of_looks(image: NDArray[Any], n: int, centroid: float, band: float) -> NDArray[np.float32]:
    """Average the intensities of n looks, as of `sub_bands`."""
    total = np.zeros(image.shape, dtype=np.float32)
    for intensity in sub_bands(image, n, centroid, band):
        total += intensity
    return total / np.float32(n)
