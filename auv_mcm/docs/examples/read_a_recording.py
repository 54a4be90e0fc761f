"""Read what the service recorded: every byte of every port, and what the decoders make of them.

    python read_a_recording.py RECORDING

RECORDING is the folder `recording` of a session, or one of its .mcap files. Any MCAP tool can open these as well.
"""

from __future__ import annotations

import sys
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

from auv_mcm.records import NavSample, Notice, Ping
from sim_replay.logs.open_log import open_log
from sim_replay.logs.session_reader import Session, recorded_config


def main(path: Path) -> None:
    """Print what a recorded session holds, port by port."""
    # First the bytes, as they came from each port ("in") and went to it ("out"), with the time at which they were read.
    session = Session(path)
    n_bytes: Counter[tuple[str, str]] = Counter()
    times_s = []
    for chunk in session:
        n_bytes[chunk.port or "(clock)", chunk.direction] += len(chunk.data)
        times_s.append(1e-9 * chunk.stamp.utc_ns)
    if times_s:
        first, last = (
            datetime.fromtimestamp(time_s, UTC).isoformat(" ", "seconds") for time_s in (times_s[0], times_s[-1])
        )
        print(f"{path}: {first} to {last}, {len(times_s)} chunks")
    for (port, direction), count in sorted(n_bytes.items()):
        print(f"  {port} {direction}: {count} bytes")

    # A recording that was cut off, by a power loss for example, is read as far as it goes; notices say what is missing.
    for notice in session.notices:
        print(f"  {notice.text}")

    # Then what the decoders make of the bytes, with the configuration that the session was recorded with: the same
    # pings and fixes, to the bit, that the live service had.
    log = open_log(path, recorded_config(session))
    n_pings, n_samples = 0, 0
    fixes: list[NavSample] = []
    for event in log:
        match event:
            case Ping():
                n_pings += 1
                n_samples += sum(len(trace.samples) for trace in (event.port, event.starboard) if trace is not None)
            case NavSample():
                fixes.append(event)
            case Notice():
                print(f"  notice {event.code}: {event.text}")
    print(f"{n_pings} pings with {n_samples} samples, {len(fixes)} navigation samples")
    if fixes:
        print(f"last position: {fixes[-1].latitude_deg:.6f}, {fixes[-1].longitude_deg:.6f} degrees")
    rejected = {name: count for name, count in log.counters.items() if "refused" in name or "skipped" in name}
    print(f"rejected by the decoders: {rejected or 'nothing'}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
