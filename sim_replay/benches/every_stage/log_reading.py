"""Measure what reading an XTF log takes and what it loses, whole and damaged, beside pyxtf's own reading."""

from __future__ import annotations

import itertools
import tempfile
import warnings
from collections.abc import Hashable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
import pyxtf

from auv_mcm.records import EchoTrace, NavSample, Ping
from auv_mcm.settings.config import SonarConfig
from sim_replay.benches.every_stage.rows import Alternative, Amount, StageRow, timed
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


def log_rows(amount: Amount) -> list[StageRow]:
    """Read drawn pings from an XTF log, whole and with a fault for every twenty of them; instead, by pyxtf.

    A ping is lost whose time or samples are not those that were written. Of pyxtf's reading counts what came before it
    failed.
    """
    pings = _drawn_pings(_PINGS_PER_INPUT * amount.n)
    wanted = [_key(round(100.0 * ping.time_s), ping.port, ping.starboard) for ping in pings]
    rows = []
    with tempfile.TemporaryDirectory(prefix="auv-mcm-bench-") as folder:
        whole, hurt = Path(folder) / "whole.xtf", Path(folder) / "damaged.xtf"
        write_xtf(whole, _with_navigation(pings))
        pieces = split(whole.read_bytes(), len(pings))
        packets = [bytes(packet) for packet in pieces.packets]
        random = np.random.Generator(np.random.PCG64(12))
        hurt_packets = damaged(packets, len(pings) // _PINGS_PER_FAULT, random)
        hurt.write_bytes(bytes(pieces.header) + hurt_packets.stream)
        for path, intact in ((whole, [True] * len(pings)), (hurt, hurt_packets.intact)):
            kept = list(itertools.compress(wanted, intact))
            (ours, cost), (theirs, other) = timed(
                amount.repeat,
                lambda path=path: list(XtfLog(path, SonarConfig())),  # type: ignore[misc]  # a default is its type
                lambda path=path: _by_pyxtf(path, 2 * len(pings)),  # type: ignore[misc]  # likewise
            )
            read = [_key(round(100.0 * e.time_s), e.port, e.starboard) for e in ours if isinstance(e, Ping)]
            found = [key for packet in theirs if (key := _pyxtf_key(packet)) is not None]
            rows.append(
                StageRow(
                    stage="logs",
                    setting=f"XTF, {path.stem}, {len(pings)} pings, {sum(intact)} intact",
                    cost=cost,
                    error=float(n_missing(kept, read)),
                    unit="intact pings lost",
                    limit=0.0,
                    alternative=Alternative(name="pyxtf", cost=other, error=float(n_missing(kept, found))),
                )
            )
    return rows


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


def _by_pyxtf(path: Path, max_packets: int) -> list[object]:
    """Read what pyxtf reads until it fails. max_packets: it goes on for ever at a packet of no length."""
    found: list[object] = []
    with warnings.catch_warnings():
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
