"""Measure what reading an XTF log takes and what it loses, whole and damaged, beside pyxtf's own reading."""

from __future__ import annotations

import itertools
import tempfile
import warnings
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyxtf

from auv_mcm.records import EchoTrace, NavSample, Ping, SourceEvent
from auv_mcm.settings.config import SonarConfig
from sim_replay.benches.every_stage.rows import Other, Row
from sim_replay.benches.mutations import split
from sim_replay.fakes.damage import damaged, n_missing
from sim_replay.logs.xtf import XtfLog
from sim_replay.logs.xtf_writer import write_xtf

_PINGS_PER_INPUT: Final = 40  # a log of 320 takes some 10 ms
_PINGS_PER_FAULT: Final = 20  # so that faults stand apart; chosen
_N_SAMPLES: Final = 1000  # of a side
_RANGE_M: Final = 50.0  # m, to either side
_PERIOD_S: Final = 0.1  # s from ping to ping
_START_S: Final = 1_700_000_000.0  # UTC, s since 1970


def log_rows(n: int) -> list[Row]:
    """Read drawn pings from an XTF log, whole and with a fault for every twenty of them; instead, by pyxtf.

    A ping is lost whose time or samples are not those that were written. Of pyxtf's reading counts what came before it
    failed.
    """
    pings = _drawn_pings(_PINGS_PER_INPUT * n)
    wanted = [_key(round(100.0 * ping.time_s), ping.port, ping.starboard) for ping in pings]
    rows = []
    with tempfile.TemporaryDirectory(prefix="auv-mcm-bench-") as folder:
        path = Path(folder) / "whole.xtf"
        write_xtf(path, _with_navigation(pings))
        whole = path.read_bytes()
    pieces = split(whole, len(pings))
    random = np.random.Generator(np.random.PCG64(12))
    hurt = damaged([bytes(packet) for packet in pieces.packets], len(pings) // _PINGS_PER_FAULT, random)
    for name, data, intact in (
        ("whole", whole, [True] * len(pings)),
        ("damaged", bytes(pieces.header) + hurt.stream, hurt.intact),
    ):
        kept = list(itertools.compress(wanted, intact))
        rows.append(
            Row(
                "logs",
                f"XTF, {name}, {len(pings)} pings, {sum(intact)} intact",
                partial(_by_us, data),
                partial(_n_lost, kept, _our_key),
                "intact pings lost",
                0.0,
                Other("pyxtf", partial(_by_pyxtf, data, 2 * len(pings)), partial(_n_lost, kept, _pyxtf_key)),
            )
        )
    return rows


def _n_lost(kept: list[Hashable], key: Callable[[Any], Hashable], read: list[Any]) -> float:
    return float(n_missing(kept, [found for one in read if (found := key(one)) is not None]))


@contextmanager
def _file_of(data: bytes) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="auv-mcm-bench-") as folder:
        path = Path(folder) / "log.xtf"
        path.write_bytes(data)
        yield path


def _by_us(data: bytes) -> list[SourceEvent]:
    with _file_of(data) as path:
        return list(XtfLog(path, SonarConfig()))


def _our_key(event: SourceEvent) -> Hashable:
    return _key(round(100.0 * event.time_s), event.port, event.starboard) if isinstance(event, Ping) else None


def _drawn_pings(n: int) -> list[Ping]:
    """Draw speckle over a quiet water column of 6 m."""
    random = np.random.Generator(np.random.PCG64(11))
    spacing_m = _RANGE_M / _N_SAMPLES
    slant_m = (np.arange(_N_SAMPLES) + 0.5) * spacing_m
    mean = np.where(slant_m < 6.0, 30.0, 3000.0 * 6.0 / slant_m)

    def side() -> EchoTrace:
        samples = np.minimum(mean * np.sqrt(random.exponential(size=_N_SAMPLES)), 65535.0).astype(np.uint16)
        return EchoTrace(samples=samples, first_range_m=0.5 * spacing_m, spacing_m=spacing_m)

    return [
        Ping(number=number, time_s=_START_S + _PERIOD_S * number, port=side(), starboard=side()) for number in range(n)
    ]


def _with_navigation(pings: list[Ping]) -> Iterator[NavSample | Ping]:
    for ping in pings:
        along_deg = 1e-6 * ping.number
        yield NavSample(
            time_s=ping.time_s,
            latitude_deg=43.0 + along_deg,
            longitude_deg=5.0,
            heading_rad=0.0,
            depth_m=10.0,
            altitude_m=6.0,
            speed_mps=1.5,
        )
        yield ping


def _key(hundredths: int, port: EchoTrace | None, starboard: EchoTrace | None) -> Hashable:
    return hundredths, *(None if side is None else side.samples.tobytes() for side in (port, starboard))


def _by_pyxtf(data: bytes, max_packets: int) -> list[object]:
    """Read what pyxtf reads until it fails. max_packets: it goes on for ever at a packet of no length."""
    found: list[object] = []
    with _file_of(data) as path, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found.extend(itertools.islice(pyxtf.xtf_read_gen(str(path)), 1, 1 + max_packets))
        except Exception:
            return found
    return found


def _pyxtf_key(packet: object) -> Hashable:
    """Take time and samples of one of pyxtf's pings, port turned from near to far; None for anything else."""
    data = getattr(packet, "data", None)
    if not isinstance(packet, pyxtf.XTFPingHeader) or not isinstance(data, list) or len(data) != 2:
        return None
    try:
        hundredths = int(packet.get_time().astype("datetime64[ms]").astype(np.int64)) // 10
    except ValueError:
        return None  # a damaged date
    return hundredths, data[0][::-1].tobytes(), data[1].tobytes()
