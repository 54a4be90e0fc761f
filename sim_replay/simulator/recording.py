"""Store echoes as numbers: time-varied gain, amplitude or logarithm, clipping, rounding."""

from __future__ import annotations

from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import EchoTrace
from sim_replay.logs.xtf_samples import SampleType
from sim_replay.simulator.scene import SampleRecorder

_USUAL: Final[dict[str, SampleRecorder]] = {
    recorder.samples: recorder
    for recorder in (
        SampleRecorder(samples="amplitude_uint8", seabed_counts=35.0, full_scale=255, db_per_count=0.5),
        SampleRecorder(samples="amplitude_uint16", seabed_counts=3000.0, full_scale=32767, db_per_count=0.5),
        SampleRecorder(samples="amplitude_float32", seabed_counts=1.0, full_scale=65535, db_per_count=0.5),
        SampleRecorder(samples="log_uint8", seabed_counts=140.0, full_scale=255, db_per_count=0.35),
        SampleRecorder(samples="log_uint16", seabed_counts=20_000.0, full_scale=65535, db_per_count=0.003),
    )
}
_TYPES: Final[dict[str, tuple[SampleType, type[np.generic]]]] = {
    "amplitude_uint8": ("uint8", np.uint8),
    "amplitude_uint16": ("uint16", np.uint16),
    "amplitude_float32": ("float32", np.float32),
    "log_uint8": ("uint8", np.uint8),
    "log_uint16": ("uint16", np.uint16),
}


def complete(recorder: SampleRecorder) -> SampleRecorder:
    """Fill the keys that the scene leaves open with the usual values of the recorder's samples."""
    usual = _USUAL[recorder.samples]
    given = {
        name: value
        for name in ("seabed_counts", "full_scale", "db_per_count")
        if (value := getattr(recorder, name)) is not None
    }
    return msgspec.structs.replace(usual, **given)


def sample_type(recorder: SampleRecorder) -> SampleType:
    """Return the sample type of the recorder in an XTF file."""
    return _TYPES[recorder.samples][0]


def largest_sample(recorder: SampleRecorder) -> int | None:
    """Return the largest number that the recorder's samples hold; None for floats."""
    kind = np.dtype(_TYPES[recorder.samples][1])
    return int(np.iinfo(kind).max) if kind.kind == "u" else None


def record(
    intensity: NDArray[np.float32], gain: NDArray[np.float64], n_ringing: int, recorder: SampleRecorder, bin_m: float
) -> list[EchoTrace]:
    """Convert intensity (n_rows, n_bins) times gain (n_bins,) to samples; the unit is the mean echo of the plain floor.

    The first n_ringing bins clip.

    Parameters
    ----------
    recorder
        Complete.
    bin_m
        Slant range per bin that the recorder believes in.
    """
    counts, full = recorder.seabed_counts or 0.0, float(recorder.full_scale or 0)
    stored = intensity * gain.astype(np.float32)
    if recorder.samples.startswith("log"):
        with np.errstate(divide="ignore"):
            np.log10(stored, out=stored)
        stored *= np.float32(10.0 / (recorder.db_per_count or 1.0))
        stored += np.float32(counts)
        np.maximum(stored, np.float32(0.0), out=stored)
    else:
        np.sqrt(stored, out=stored)
        stored *= np.float32(counts)
    stored[:, :n_ringing] = full
    np.minimum(stored, np.float32(full), out=stored)
    kind = _TYPES[recorder.samples][1]
    samples: NDArray[Any] = stored if kind is np.float32 else np.rint(stored, out=stored).astype(kind)
    return [EchoTrace(samples=row, first_range_m=0.5 * bin_m, spacing_m=bin_m) for row in samples]
