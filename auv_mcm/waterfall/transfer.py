"""What a recorded number means: amplitude, intensity, or a logarithm; and how to tell from speckle.

Fully developed single-look speckle has exponential intensity. Then amplitude is Rayleigh (skewness +0.63, standard deviation
0.52 of the mean), intensity exponential (skewness +2, standard deviation equal to the mean), and the logarithm Gumbel
(skewness -1.14, standard deviation 5.57 dB whatever the mean). The sign of the skewness survives averaging of looks,
gain, and (for the logarithm) offset, so it decides; the standard deviation of a logarithm gives its decibels per count.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.config import SonarConfig
from auv_mcm.records import NAN, EchoTrace, Notice

SINGLE_LOOK_STD_DB: Final = 10.0 / math.log(10.0) * math.pi / math.sqrt(6.0)
_WINDOW: Final = 64
_MIN_WINDOWS: Final = 16

TransferKind = Literal["amplitude", "intensity", "log"]


class Transfer(NamedTuple):
    """How samples become intensity; `db_per_count` is NaN unless `kind` is "log"."""

    kind: TransferKind
    db_per_count: float = NAN


class SpeckleEvidence(NamedTuple):
    """Medians over short windows of the brighter half of the samples: skewness, standard deviation over mean, and in counts."""

    skewness: float
    relative_std: float
    std_counts: float
    n_windows: int


def to_intensity(samples: NDArray[Any], transfer: Transfer) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Linear intensity (n_samples,) float32 and its validity (n_samples,) bool of recorded samples.

    Non-finite samples, and negative ones unless logarithmic, are invalid and zero in the result.
    """
    if samples.dtype.kind == "u":
        valid = np.ones(samples.shape, dtype=np.bool_)
    else:
        valid = np.isfinite(samples) if samples.dtype.kind == "f" else np.ones(samples.shape, dtype=np.bool_)
        if transfer.kind != "log":
            valid &= samples >= 0
    counts = samples.astype(np.float32)
    if not valid.all():
        counts[~valid] = 0.0
    if transfer.kind == "amplitude":
        np.multiply(counts, counts, out=counts)
    elif transfer.kind == "log":
        # Referred to 100 dB so that 16 bits of a tenth of a decibel stay far from the ends of float32.
        exponent = np.clip(counts * np.float32(transfer.db_per_count / 10.0) - np.float32(10.0), -30.0, 30.0)
        np.power(np.float32(10.0), exponent, out=counts)
        if not valid.all():
            counts[~valid] = 0.0
    return counts, valid


def speckle_evidence(traces: Sequence[EchoTrace]) -> SpeckleEvidence:
    """Speckle statistics of recorded samples over windows of 64 samples with the linear trend removed.

    The brighter half of the windows is used, which is sea floor rather than water column. NaN with no usable window.
    """
    windows = []
    for trace in traces:
        samples = np.asarray(trace.samples, dtype=np.float64)
        start = samples.shape[0] // 8
        n_windows = (samples.shape[0] - start) // _WINDOW
        if n_windows > 0:
            windows.append(samples[start : start + n_windows * _WINDOW].reshape(n_windows, _WINDOW))
    if not windows:
        return SpeckleEvidence(NAN, NAN, NAN, 0)
    stack = np.concatenate(windows)
    stack = stack[np.isfinite(stack).all(axis=1)]
    # A clipped window has no tail left to judge.
    if stack.size:
        clipped = (stack == stack.max()).sum(axis=1) > 2
        stack = stack[~clipped]
    mean = stack.mean(axis=1) if stack.size else np.empty(0)
    ramp = np.arange(_WINDOW) - (_WINDOW - 1) / 2.0
    residual = stack - mean[:, None] - ramp * ((stack @ ramp) / (ramp @ ramp))[:, None]
    std = np.sqrt((residual**2).mean(axis=1))
    good = std > 0.0
    if good.sum() < _MIN_WINDOWS:
        return SpeckleEvidence(NAN, NAN, NAN, int(good.sum()))
    mean, std, residual = mean[good], std[good], residual[good]
    bright = mean >= np.median(mean)
    skewness = ((residual[bright] / std[bright, None]) ** 3).mean(axis=1)
    ratio = std[bright] / np.maximum(np.abs(mean[bright]), 1e-300)
    return SpeckleEvidence(float(np.median(skewness)), float(np.median(ratio)), float(np.median(std[bright])), int(good.sum()))


def kind_from_speckle(evidence: SpeckleEvidence) -> TransferKind:
    """The transfer that fits the evidence best; amplitude, the commonest, where there is none."""
    if evidence.n_windows < _MIN_WINDOWS:
        return "amplitude"
    if evidence.skewness < 0.05 and evidence.relative_std < 0.4:
        return "log"
    return "intensity" if evidence.relative_std > 0.75 else "amplitude"


def resolve_transfer(sonar: SonarConfig, traces: Sequence[EchoTrace]) -> tuple[Transfer, tuple[Notice, ...]]:
    """The transfer to use for a mission whose first pings hold `traces`, with what a person should know about the choice.

    A configured transfer is kept and only checked; "auto" takes what the speckle says.
    """
    evidence = speckle_evidence(traces)
    likely = kind_from_speckle(evidence)
    kind = likely if sonar.transfer == "auto" else sonar.transfer
    estimated_db = SINGLE_LOOK_STD_DB / evidence.std_counts if evidence.n_windows >= _MIN_WINDOWS else NAN
    db_per_count = NAN
    if kind == "log":
        db_per_count = sonar.db_per_count if sonar.db_per_count is not None else estimated_db
        if not math.isfinite(db_per_count):
            db_per_count = 0.35
    notices = []
    measured = f"speckle skewness {evidence.skewness:+.2f}, standard deviation {evidence.relative_std:.2f} of the mean"
    if evidence.n_windows < _MIN_WINDOWS:
        text = f"too few usable samples to check the sample transfer; '{kind}' is used. Set sonar.transfer."
        notices.append(Notice(code="transfer.unchecked", text=text))
    elif sonar.transfer == "auto":
        detail = f", {db_per_count:.3f} dB per count" if kind == "log" else ""
        notices.append(
            Notice(
                code="transfer.chosen",
                text=f"samples are taken as '{kind}'{detail} ({measured}). Set sonar.transfer if the recorder's manual says otherwise.",
            )
        )
    elif kind != likely:
        notices.append(
            Notice(
                code="transfer.disagrees",
                text=f"sonar.transfer is '{kind}' but the samples look like '{likely}' ({measured}); "
                "if it is wrong, contrast and false alarms suffer. Check the recorder's manual.",
            )
        )
    configured_db = sonar.db_per_count
    if kind == "log" and configured_db is not None and math.isfinite(estimated_db) and not 0.5 < estimated_db / configured_db < 2.0:
        notices.append(
            Notice(
                code="transfer.db_per_count",
                text=f"sonar.db_per_count is {configured_db:g} but single-look speckle would need {estimated_db:.3f}.",
            )
        )
    return Transfer(kind, db_per_count), tuple(notices)
