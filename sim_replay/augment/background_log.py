"""A recorded log as targets are put into it: where its pings were, how high, and at which bytes of the file their
samples lie.

Geometry is the waterfall's own: the same reader, poses, along-track distances and bottom tracking. Samples are
overwritten in a copy of the file, so that everything else in it stays as it was recorded, to the last bit.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import pyxtf
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.intake import Intake, PingBlock, SegmentEnd
from auv_mcm.records import SIDES, EchoTrace, NavSample, Ping, PoseTrack, Side, Transfer
from auv_mcm.safe_files import open_regular
from auv_mcm.settings.config import Config
from auv_mcm.waterfall.bottom import BottomTrack, BottomTracker
from auv_mcm.waterfall.grid import concatenate_poses
from auv_mcm.waterfall.ground import Traces, make_traces
from auv_mcm.waterfall.law_watch import law_of_pings
from auv_mcm.waterfall.quality import TraceChecker
from auv_mcm.waterfall.transfer import to_intensity
from sim_replay.logs.open_log import find_format, open_log
from sim_replay.logs.xtf_header import SIDE_SCAN, channels
from sim_replay.logs.xtf_packets import HEADER_BLOCK, XtfPacket, header_bytes, read_packets
from sim_replay.simulator.echo import absorption_db_per_km
from sim_replay.simulator.scene import Sonar

_SONAR_PACKET: Final = 0  # XTF header type of a ping
_PING_HEADER: Final = 256  # bytes (XTF)
_CHANNEL_HEADER: Final = 64  # bytes (XTF)
_APART: Final = 8  # packets from the first of a ping to its last, as of four frequencies (chosen)
_NEPERS_PER_DB: Final = 0.1 * math.log(10.0)  # of power
_DEPTH_M: Final = 20.0  # absorption hardly depends on it

Floats: TypeAlias = NDArray[np.float64]


class Stretch(NamedTuple):
    """Hold consecutive pings of equal layout without a gap in time; arrays are (n_pings,).

    along_m: float64 distance from mission start. first_return_m: float64 slant range of the first bottom return.
    bottom_seen: bool. yaw_rate_rad_s, pitch_rate_rad_s: float64.
    """

    pings: list[Ping]
    poses: PoseTrack
    along_m: Floats
    first_return_m: Floats
    bottom_seen: NDArray[np.bool_]
    yaw_rate_rad_s: Floats
    pitch_rate_rad_s: Floats

    @property
    def n_pings(self) -> int:
        """Count the pings."""
        return len(self.pings)

    def trace(self, ping: int, side: Side) -> EchoTrace | None:
        """Return the samples of one side of one ping, by index in the stretch."""
        return self.pings[ping].port if side == "port" else self.pings[ping].starboard


class Survey(NamedTuple):
    """Hold a log with the geometry of its pings.

    full_scale: stored number at which each side clips, None if it does not.

    absorption_per_m: of sea water at the frequency that the log states, two-way, nepers of power; 0 if it states none.
    """

    path: Path
    stretches: tuple[Stretch, ...]
    transfer: Transfer
    full_scale: dict[Side, float | None]
    absorption_per_m: float


class SamplePlace(NamedTuple):
    """Locate a trace in the file: byte of its first stored sample; turned: the farthest sample is stored first."""

    offset: int
    turned: bool


def read_survey(path: Path, config: Config) -> Survey:
    """Read a log whole; memory is about what the file takes.

    Raises BadInputError for anything but an XTF log with side-scan pings, or where none has navigation.
    """
    pings: list[Ping] = []
    intake = Intake(config, Counter())
    released: list[PingBlock | SegmentEnd] = []
    if (found := find_format(path)).name != "xtf":
        raise BadInputError(
            f"{path} is a log of format {found.title}; objects are embedded in XTF logs alone, since every "
            "other byte is kept. Export it as XTF."
        )
    for event in open_log(path, config):
        if isinstance(event, NavSample):
            intake.add_navigation(event)
        elif isinstance(event, Ping):
            pings.append(event)
            released += intake.add_ping(event)
    released += intake.flush()
    transfer = law_of_pings(pings, config.sonar).transfer
    full_scale = {side: _full_scale(pings, side, config.sonar.full_scale) for side in SIDES}
    stretches = tuple(_stretches(released, intake, transfer, config))
    if not stretches:
        raise BadInputError(
            f"{path} has no pings that can be placed along a track. Give a log with time stamps and navigation."
        )
    return Survey(path, stretches, transfer, full_scale, _absorption_per_m(path))


def _absorption_per_m(path: Path) -> float:
    with open_regular(path) as file:
        data = file.read(HEADER_BLOCK)
    header = pyxtf.XTFFileHeader.from_buffer_copy(data)
    stated = [c.frequency for c in channels(header, data) if c.kind in SIDE_SCAN and c.frequency > 0.0]
    if not stated:
        return 0.0
    # Some recorders state kilohertz, others hertz.
    frequency_khz = stated[0] if stated[0] < 1e4 else 1e-3 * stated[0]
    if not 10.0 <= frequency_khz <= 3000.0:
        return 0.0
    return 2e-3 * _NEPERS_PER_DB * absorption_db_per_km(Sonar(frequency_khz=frequency_khz), _DEPTH_M)


def _full_scale(pings: Sequence[Ping], side: Side, configured: float | None) -> float | None:
    """Return the stored number at which a converter clips: all ones, often of fewer bits than the stored type has."""
    if configured is not None:
        return configured
    traces = [trace for ping in pings if (trace := ping.port if side == "port" else ping.starboard) is not None]
    kinds = {trace.samples.dtype.kind for trace in traces}
    if not traces or kinds - {"u", "i"}:
        return None
    highest = max(int(trace.samples.max(initial=0)) for trace in traces)
    return float(max((1 << highest.bit_length()) - 1, 255))


def _stretches(
    released: Sequence[PingBlock | SegmentEnd], intake: Intake, transfer: Transfer, config: Config
) -> Iterator[Stretch]:
    run: list[PingBlock] = []
    along_m = 0.0
    for item in released:
        if run and (isinstance(item, SegmentEnd) or _layout(item.pings[0]) != _layout(run[0].pings[0])):
            yield _tracked(run, transfer, config)
            run = []
        if isinstance(item, SegmentEnd):
            intake.start_segment(along_m)
        else:
            run.append(intake.place_along_track(item))
            along_m = float(run[-1].along_m[-1])


def _layout(ping: Ping) -> tuple[object, ...]:
    return tuple(
        (t.samples.shape[0], t.first_range_m, t.spacing_m) if t is not None else None
        for t in (ping.port, ping.starboard)
    )


def _tracked(blocks: Sequence[PingBlock], transfer: Transfer, config: Config) -> Stretch:
    tracker = BottomTracker(config.sonar.blank_m)
    checkers = {side: TraceChecker(side, transfer, config.sonar.full_scale, Counter()) for side in SIDES}
    tracks: list[BottomTrack] = []
    for block in blocks:
        traces = {side: _traces(block.pings, side, checkers[side]) for side in SIDES}
        reach_m = max(t.first_range_m + t.n_samples * t.spacing_m for t in traces.values() if t is not None)
        track = tracker.add(list(traces.values()), block.poses.altitude_m, min(reach_m, config.sonar.max_range_m))
        tracks += [track] if track is not None else []
    last = tracker.flush()
    tracks += [last] if last is not None else []
    return Stretch(
        [ping for block in blocks for ping in block.pings],
        concatenate_poses([block.poses for block in blocks]),
        np.concatenate([block.along_m for block in blocks]),
        np.maximum(np.concatenate([track.first_return_m for track in tracks]), 0.05),
        np.concatenate([track.seen for track in tracks]),
        np.concatenate([block.yaw_rate_rad_s for block in blocks]),
        np.concatenate([block.pitch_rate_rad_s for block in blocks]),
    )


def _traces(pings: Sequence[Ping], side: Side, checker: TraceChecker) -> Traces | None:
    traces = [ping.port if side == "port" else ping.starboard for ping in pings]
    if traces[0] is None:
        return None
    checked = [checker.check(trace) for trace in traces if trace is not None]
    return make_traces(
        np.stack([c.intensity for c in checked]),
        np.stack([c.valid for c in checked]),
        np.stack([c.saturated for c in checked]),
        traces[0].first_range_m,
        traces[0].spacing_m,
    )


# --- samples ---


def window_intensity(
    stretch: Stretch, pings: slice, side: Side, transfer: Transfer
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return linear intensity (n_pings, n_samples) float32 of some pings, near to far, and its validity, bool.

    The side must have been recorded, see `side_recorded`.
    """
    traces = [stretch.trace(k, side) for k in range(*pings.indices(stretch.n_pings))]
    some = [to_intensity(trace.samples, transfer) for trace in traces if trace is not None]
    return np.stack([intensity for intensity, _ in some]), np.stack([valid for _, valid in some])


def to_samples(intensity: Floats, transfer: Transfer, full_scale: float | None, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Convert linear intensities to stored numbers, clipped at full scale.

    The inverse of `auv_mcm.waterfall.transfer.to_intensity`.
    """
    if transfer.kind == "amplitude":
        counts = np.sqrt(intensity)
    elif transfer.kind == "intensity":
        counts = np.asarray(intensity, dtype=np.float64)
    else:
        counts = (10.0 * np.log10(np.maximum(intensity, 1e-30)) + 100.0) / transfer.db_per_count
    if dtype.kind in "ui":
        limits = np.iinfo(dtype)
        # A logarithm, too, starts at the minimum that the recorder stores.
        return np.asarray(
            np.rint(np.clip(counts, max(limits.min, 0), min(limits.max, full_scale or limits.max))), dtype=dtype
        )
    return np.asarray(np.minimum(counts, np.inf if full_scale is None else full_scale), dtype=dtype)


def sample_places(path: Path, pings: Sequence[Ping]) -> dict[tuple[int, Side], SamplePlace]:
    """Locate the traces of `pings`, in the reader's order, in the file, by ping number and side.

    Found by walking the same packets as the reader and comparing samples, so that a place is returned only where the
    bytes there are those samples; a trace that the reader scaled has none.
    """
    places: dict[tuple[int, Side], SamplePlace] = {}
    with open_regular(path) as file:
        size = path.stat().st_size
        first = header_bytes(file, 0, size) or HEADER_BLOCK
        packets = read_packets(file, first, size, (_SONAR_PACKET,))
        channels = (
            (item.offset, item.data) for item in packets if isinstance(item, XtfPacket) and item.kind == _SONAR_PACKET
        )
        ahead = deque(islice(channels, _APART))
        for ping in pings:
            found: dict[Side, SamplePlace] = {}
            while ahead and not found:
                found = _matches(ping, *ahead.popleft(), SIDES)
                ahead.extend(islice(channels, 1))
            for offset, data in ahead if found else ():  # a recorder may write each side into a packet of its own
                found |= _matches(ping, offset, data, [side for side in SIDES if side not in found])
            places |= {(ping.number, side): place for side, place in found.items()}
    return places


def _matches(ping: Ping, offset: int, data: bytes, sides: Sequence[Side]) -> dict[Side, SamplePlace]:
    """Locate the samples of some sides in the packet at `offset` of the file; empty if it is another ping's packet."""
    found: dict[Side, SamplePlace] = {}
    start = _PING_HEADER
    while start + _CHANNEL_HEADER <= len(data):
        n_samples = int(pyxtf.XTFPingChanHeader.from_buffer_copy(data, start).NumSamples)
        start += _CHANNEL_HEADER
        itemsize = 1
        for side in sides:
            trace = ping.port if side == "port" else ping.starboard
            if side in found or trace is None:
                continue
            itemsize = trace.samples.dtype.itemsize
            n_samples = n_samples or trace.samples.shape[0]
            if n_samples != trace.samples.shape[0] or start + n_samples * itemsize > len(data):
                continue
            stored = np.frombuffer(data, trace.samples.dtype, n_samples, start)
            turned = np.array_equal(stored[::-1], trace.samples, equal_nan=True)
            if turned or np.array_equal(stored, trace.samples, equal_nan=True):
                found[side] = SamplePlace(offset + start, turned)
                break
        start += n_samples * itemsize
    return found


def overwrite(data: bytearray, place: SamplePlace, samples: NDArray[Any], changed: NDArray[np.bool_]) -> None:
    """Overwrite a trace's changed samples in the file, near to far."""
    stored = np.frombuffer(data, samples.dtype, samples.shape[0], place.offset)
    near_to_far = stored[::-1] if place.turned else stored
    near_to_far[changed] = samples[changed]
