"""What a recorded number means: amplitude, intensity, or a logarithm; and how to tell from speckle.

Fully developed single-look speckle has exponential intensity. Then amplitude is Rayleigh (skewness +0.63, standard deviation
0.52 of the mean), intensity exponential (skewness +2, standard deviation equal to the mean), and the logarithm Gumbel
(skewness -1.14, standard deviation 5.57 dB whatever the mean). The sign of the skewness survives averaging of looks,
gain, and (for the logarithm) offset, so it tells the logarithm from the others; its standard deviation gives the decibels per
count if looks were not averaged. Intensity of several averaged looks cannot be told from amplitude over a textured sea floor:
only single-look intensity is recognised, the rest is taken as amplitude.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.records import NAN, EchoTrace, Notice
from auv_mcm.settings.config import SonarConfig

SINGLE_LOOK_STD_DB: Final = 10.0 / math.log(10.0) * math.pi / math.sqrt(6.0)
_WINDOW: Final = 64
_MIN_WINDOWS: Final = 16
_USUAL_DB_PER_COUNT: Final = 0.35  # 8 bits over 90 dB, where speckle cannot tell
_INTENSITY_STD: Final = 0.72  # of the mean, in the more even windows: amplitude 0.45 to 0.6 over any sea floor, intensity 0.85 and more
_SKEWED: Final = 1.3  # skewness over relative deviation: amplitude at most 1.2, intensity 2, less 0.4 in windows of 64 samples
_MAX_AMPLITUDE: Final = np.float64(1e19)  # in double precision, so that half-precision samples compare too
_MAX_INTENSITY: Final = np.float64(1e38)

TransferKind = Literal["amplitude", "intensity", "log"]


class Transfer(NamedTuple):
    """How samples become intensity; `db_per_count` is NaN unless `kind` is "log"."""

    kind: TransferKind
    db_per_count: float = NAN


class SpeckleEvidence(NamedTuple):
    """Over short windows, medians: skewness, standard deviation over the mean's magnitude, and standard deviation in counts.

    even_relative_std: lower quartile of the second. Patches of plants or stones spread samples beyond what speckle does, and nothing
    spreads them less: the more even windows tell of speckle alone.
    """

    skewness: float
    relative_std: float
    even_relative_std: float
    std_counts: float
    n_windows: int


def to_intensity(samples: NDArray[Any], transfer: Transfer) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Linear intensity (n_samples,) float32 and its validity (n_samples,) bool of recorded samples.

    Non-finite samples, absurdly large ones, and negative ones unless logarithmic, are invalid and zero in the result.
    """
    if samples.dtype.kind == "f":
        # Numbers beyond what float32 holds, once squared if need be, were never measured.
        valid = np.abs(samples) <= (_MAX_AMPLITUDE if transfer.kind == "amplitude" else _MAX_INTENSITY)
    else:
        valid = np.ones(samples.shape, dtype=np.bool_)
    if samples.dtype.kind != "u" and transfer.kind != "log":
        valid &= samples >= 0
    counts = (samples if valid.all() else np.where(valid, samples, 0)).astype(np.float32)
    if transfer.kind == "amplitude":
        np.multiply(counts, counts, out=counts)
    elif transfer.kind == "log":
        # Referred to 100 dB, where 8-bit recorders have their sea floor, and bounded to what float32 holds.
        exponent = np.clip(counts * np.float32(transfer.db_per_count / 10.0) - np.float32(10.0), -30.0, 30.0)
        np.power(np.float32(10.0), exponent, out=counts)
        if not valid.all():
            counts[~valid] = 0.0
    return counts, valid


def speckle_evidence(traces: Sequence[EchoTrace]) -> SpeckleEvidence:
    """Speckle statistics of recorded samples over windows of 64 samples with the linear trend removed.

    The windows with the brighter neighbours are used, which lie on the sea floor rather than in the water column: choosing by
    their own mean would favour those that happen to hold no deep fade. NaN with too few usable windows.
    """
    windows, surroundings = [], []
    for trace in traces:
        start = trace.samples.shape[0] // 8
        n_windows = (trace.samples.shape[0] - start) // _WINDOW
        if n_windows < 2:
            continue
        window = trace.samples[start : start + n_windows * _WINDOW].reshape(n_windows, _WINDOW).astype(np.float64)
        window[~(np.abs(window) <= _MAX_AMPLITUDE).all(axis=1)] = NAN
        mean = window.mean(axis=1)
        windows.append(window)
        surroundings.append(0.5 * (np.concatenate([mean[1:2], mean[:-1]]) + np.concatenate([mean[1:], mean[-2:-1]])))
    if not windows:
        return SpeckleEvidence(NAN, NAN, NAN, NAN, 0)
    stack, brightness = np.concatenate(windows), np.concatenate(surroundings)
    finite = np.isfinite(stack[:, 0]) & np.isfinite(brightness)
    # A clipped window has no tail left to judge.
    clipped = (stack == np.max(stack[finite], initial=-math.inf)).sum(axis=1) > 2
    stack, brightness = stack[finite & ~clipped], brightness[finite & ~clipped]
    mean = stack.mean(axis=1, keepdims=True)
    ramp = np.arange(_WINDOW) - (_WINDOW - 1) / 2.0
    residual = stack - mean - ramp * (stack @ ramp / (ramp @ ramp))[:, None]
    std = np.sqrt((residual**2).sum(axis=1) / (_WINDOW - 2))
    # A constant window leaves rounding errors only.
    good = std > 1e-9 * np.abs(stack).max(axis=1, initial=0.0)
    n_good = int(np.count_nonzero(good))
    if n_good < _MIN_WINDOWS:
        return SpeckleEvidence(NAN, NAN, NAN, NAN, n_good)
    bright = good & (brightness >= np.median(brightness[good]))
    mean, std, residual = mean[bright, 0], std[bright], residual[bright]
    skewness = ((residual / std[:, None]) ** 3).mean(axis=1)
    relative_std = std / np.maximum(np.abs(mean), 1e-9 * std)
    even, middle = np.quantile(relative_std, (0.25, 0.5)).tolist()
    return SpeckleEvidence(float(np.median(skewness)), middle, even, float(np.median(std)), n_good)


def kind_from_speckle(evidence: SpeckleEvidence) -> TransferKind:
    """The transfer that fits the evidence best; amplitude, the commonest, where there is none."""
    if evidence.n_windows < _MIN_WINDOWS:
        return "amplitude"
    # Averaged looks bring the skewness of all three near zero, but only a logarithm's spread is then small against its mean
    # and its skewness negative; around 0 dB the mean says nothing and the skewness must be plain.
    if evidence.skewness < -0.3 or (evidence.skewness < 0.05 and evidence.relative_std < 0.4):
        return "log"
    return "intensity" if evidence.even_relative_std > _INTENSITY_STD else "amplitude"


def recheck_transfer(transfer: Transfer, traces: Sequence[EchoTrace], place: str) -> Notice | None:
    """What a person should know if later traces, as of another log, speak against the transfer in use."""
    evidence = speckle_evidence(traces)
    likely = kind_from_speckle(evidence)
    if evidence.n_windows < _MIN_WINDOWS or likely == transfer.kind:
        return None
    text = (
        f"samples look like '{likely}' from here on but are still taken as '{transfer.kind}': contrast and false alarms suffer. "
        "Replay logs of different recorders apart, or set sonar.transfer."
    )
    return Notice(code="transfer.disagrees", text=text, place=place)


def resolve_transfer(
    sonar: SonarConfig, traces: Sequence[EchoTrace], told: TransferKind | None = None
) -> tuple[Transfer, tuple[Notice, ...]]:
    """The transfer to use for a mission whose first pings hold `traces`, with what a person should know about the choice.

    A configured transfer is kept and only checked; "auto" takes what the sonar's protocol told or, if it told nothing, what the speckle
    says.
    """
    evidence = speckle_evidence(traces)
    likely = kind_from_speckle(evidence)
    known = told if sonar.transfer == "auto" else sonar.transfer
    kind = likely if known is None else known
    estimated_db = SINGLE_LOOK_STD_DB / evidence.std_counts if evidence.n_windows >= _MIN_WINDOWS else NAN
    db_per_count = NAN
    if kind == "log":
        db_per_count = sonar.db_per_count if sonar.db_per_count is not None else estimated_db
        if not math.isfinite(db_per_count):
            db_per_count = _USUAL_DB_PER_COUNT
    notices = []
    measured = f"speckle skewness {evidence.skewness:+.2f}, standard deviation {evidence.relative_std:.2f} of the mean"
    if evidence.n_windows < _MIN_WINDOWS:
        text = f"too few usable samples to check the sample transfer; '{kind}' is used. Set sonar.transfer."
        notices.append(Notice(code="transfer.unchecked", text=text))
    elif known is None:
        detail = f", {db_per_count:.3f} dB per count" if kind == "log" else ""
        notices.append(
            Notice(
                code="transfer.chosen",
                text=f"samples are taken as '{kind}'{detail} ({measured}). Set sonar.transfer if the recorder's manual says otherwise.",
            )
        )
    elif kind != likely and not (kind == "intensity" and likely == "amplitude" and evidence.skewness > _SKEWED * evidence.relative_std):
        notices.append(
            Notice(
                code="transfer.disagrees",
                text=f"{'the sonar tells' if sonar.transfer == 'auto' else 'sonar.transfer is'} '{kind}' but the samples look like "
                f"'{likely}' ({measured}); if it is wrong, contrast and false alarms suffer. Check the recorder's manual.",
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
