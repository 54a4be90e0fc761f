"""Damage recorded pings and navigation. The truth does not change by it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final, Literal, NamedTuple

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from auv_mcm.records import SIDES, EchoTrace, NavSample, Ping, Side
from sim_replay.simulator.scene import Fault, SampleRecorder

# m of range, of an echo sounder's pulses of half a millisecond, about twenty a second, near a multiple of the ping rate
_PULSE_M: Final = 0.4
_PULSES_APART_M: Final = 35.0
_PULSES_MOVE_M: Final = 1.85


class _Beat(NamedTuple):
    """Hold all events of one ping number: the navigation that precedes the ping, and the ping unless it is lost."""

    number: int
    navigation: tuple[NavSample, ...]
    ping: Ping | None


def with_faults(
    events: Iterable[NavSample | Ping], faults: Sequence[Fault], recorder: SampleRecorder
) -> Iterator[NavSample | Ping]:
    """Yield the events as they arrive once `faults` have happened, applied in the order given.

    A navigation sample belongs to the ping that follows it. A lost ping leaves its navigation behind and its number
    unused. A stuck channel repeats what it brought last before, or what it brings first if there is none. A fault acts
    on what the faults before it left: a gain step listed after a stuck channel changes the samples that it repeats.
    `side` matters to gain_step, stuck_channel, dead_channel and interference.

    recorder: what the samples are. The gain changes amplitudes by a factor and logarithms by counts, rounded where
    samples are integers and clipped to `full_scale`, or else to what their type holds.

    Raises UsageError, before the first event, for a gain step or interference in logarithms whose `db_per_count` is not
    given.
    """
    beats = _beats(events)
    for fault in faults:
        beats = _struck(beats, fault, recorder)
    for beat in beats:
        yield from beat.navigation
        if beat.ping is not None:
            yield beat.ping


def _beats(events: Iterable[NavSample | Ping]) -> Iterator[_Beat]:
    navigation: list[NavSample] = []
    number = -1
    for event in events:
        if isinstance(event, NavSample):
            navigation.append(event)
            continue
        number = event.number
        yield _Beat(number, tuple(navigation), event)
        navigation = []
    if navigation:
        yield _Beat(number + 1, tuple(navigation), None)


def _struck(beats: Iterable[_Beat], fault: Fault, recorder: SampleRecorder) -> Iterator[_Beat]:
    factor, counts = _gain(fault, recorder) if fault.kind in ("gain_step", "interference") else (1.0, 0.0)
    last: dict[str, EchoTrace] = {}
    for beat in beats:
        nth = beat.number - fault.at_ping
        happens = 0 <= nth < fault.n_pings
        traces = _traces(beat.ping, fault.side)
        if fault.kind == "stuck_channel" and not happens:
            last.update(traces)
        match fault.kind:
            case "drop" if happens and nth % 2 == 0:
                yield beat._replace(ping=None)
            case "gap" if happens:
                yield beat._replace(ping=None)
            case "gain_step" if happens:
                yield _bringing(
                    beat,
                    {side: _amplified(trace, factor, counts, recorder.full_scale) for side, trace in traces.items()},
                )
            case "interference" if happens:
                struck = {
                    side: _with_pulses(trace, beat.number, factor, counts, recorder.full_scale)
                    for side, trace in traces.items()
                }
                yield _bringing(beat, struck)
            case "stuck_channel" if happens:
                yield _bringing(beat, {side: last.setdefault(side, trace) for side, trace in traces.items()})
            case "dead_channel" if happens:
                yield _bringing(beat, dict.fromkeys(traces))
            case "clock_step" if nth >= 0:
                yield _later(beat, fault.step_s)
            case "navigation_loss" if happens:
                yield beat._replace(navigation=())
            case _:
                yield beat


def _traces(ping: Ping | None, side: Literal["port", "starboard", "both"]) -> dict[str, EchoTrace]:
    """Return the ping's traces on a fault's sides."""
    sides: Sequence[Side] = SIDES if side == "both" else (side,)
    return {side: trace for side in sides if (trace := getattr(ping, side, None)) is not None}


def _bringing(beat: _Beat, traces: Mapping[str, EchoTrace | None]) -> _Beat:
    return beat if beat.ping is None else beat._replace(ping=structs.replace(beat.ping, **traces))


def _later(beat: _Beat, step_s: float) -> _Beat:
    navigation = tuple(structs.replace(sample, time_s=sample.time_s + step_s) for sample in beat.navigation)
    ping = None if beat.ping is None else structs.replace(beat.ping, time_s=beat.ping.time_s + step_s)
    return beat._replace(navigation=navigation, ping=ping)


def _gain(fault: Fault, recorder: SampleRecorder) -> tuple[float, float]:
    """Return the factor on the samples, and the counts added after it."""
    if not recorder.samples.startswith("log"):
        return 10.0 ** (fault.gain_db / 20.0), 0.0
    if recorder.db_per_count is None:
        raise UsageError(
            f"`gain_db` of a fault '{fault.kind}' in logarithmic samples needs their scale: give "
            "`sonar.recorder.db_per_count`"
        )
    return 1.0, fault.gain_db / recorder.db_per_count


def _amplified(trace: EchoTrace, factor: float, counts: float, full_scale: int | None) -> EchoTrace:
    return _recorded(trace, trace.samples.astype(np.float64) * factor + counts, full_scale)


def _with_pulses(trace: EchoTrace, number: int, factor: float, counts: float, full_scale: int | None) -> EchoTrace:
    """Add the pulses of a sounder at a rate of its own, which come at another range in each ping."""
    samples = trace.samples.astype(np.float64)
    range_m = trace.first_range_m + trace.spacing_m * np.arange(samples.size)
    is_pulse = (range_m - number * _PULSES_MOVE_M) % _PULSES_APART_M < _PULSE_M
    pulse = float(np.median(samples)) * factor + counts
    return _recorded(trace, np.where(is_pulse, np.maximum(samples, pulse), samples), full_scale)


def _recorded(trace: EchoTrace, samples: NDArray[np.float64], full_scale: int | None) -> EchoTrace:
    dtype = trace.samples.dtype
    if dtype.kind in "iu":
        largest = int(np.iinfo(dtype).max)
        samples = np.clip(np.rint(samples), 0, largest if full_scale is None else min(full_scale, largest))
    elif full_scale is not None:
        samples = np.minimum(samples, full_scale)
    return structs.replace(trace, samples=samples.astype(dtype))
