"""Test your sonar driver without the sonar: pieces, damage, and the contacts that come of a mission through it.

    python test_your_driver.py LOG MODULE

MODULE is a file beside this one with the driver, `SONAR`, and `encode(ping)`, the bytes that the device sends for a
ping; `own_driver` is one. LOG is a simulated or recorded mission: `auv-mcm simulate demo --out sim` makes one. It ends
with an error where the driver does not hold. For the whole service between fake devices there is `auv-mcm hil`.
"""

import importlib
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec

from auv_mcm.clock import Stamp
from auv_mcm.pipeline import Pipeline
from auv_mcm.records import NavSample, Ping
from auv_mcm.settings.config import Config, SonarConfig
from drivers.sonar.sonar_decoder import SonarFrame
from sim_replay.logs.open_log import open_log


def decoded(driver: Any, chunks: Iterable[bytes]) -> list[SonarFrame]:
    """Send bytes through a new decoder; return its frames."""
    decoder = driver.SONAR.decoder(SonarConfig())
    found = [frame for chunk in chunks for frame in decoder.feed(chunk, Stamp(0, 0))] + decoder.finish()
    return [frame for frame in found if isinstance(frame, SonarFrame)]


def main(log: Path, module: str) -> None:
    """Check a driver on the pings of a log, and find contacts in what it decodes."""
    sys.path.insert(0, str(Path(__file__).parent))
    driver = importlib.import_module(module)
    events = [event for event in open_log(log, Config()) if isinstance(event, Ping | NavSample)]
    messages = [driver.encode(event) for event in events if isinstance(event, Ping)]
    frames = decoded(driver, messages)
    assert len(frames) == len(messages), f"{len(frames)} of {len(messages)} pings were decoded"
    few = b"".join(messages[:20])
    for size in (1, 7, 1000):
        pieces = (few[at : at + size] for at in range(0, len(few), size))
        numbers = [one.number for one in decoded(driver, pieces)]
        assert numbers == [one.number for one in frames[:20]], f"pieces of {size} bytes give other frames"
    hit = [bytearray(message) for message in messages]
    for message in hit[::10]:
        message[len(message) // 2] ^= 0xFF
    n_lost = len(messages) - len(decoded(driver, map(bytes, hit)))
    assert n_lost <= len(hit[::10]), f"{len(hit[::10])} damaged pings cost {n_lost}"
    chain, left = Pipeline(Config()), iter(frames)
    for event in events:
        if isinstance(event, Ping):
            frame = next(left)
            event = msgspec.structs.replace(event, port=frame.port, starboard=frame.starboard)
        chain.feed(event)
    chain.finish()
    mine_like = sum(contact.p_mine >= 0.2 for contact in chain.contacts)
    print(f"{len(frames)} pings decoded, in any pieces; {len(hit[::10])} damaged, {n_lost} lost; {mine_like} mine-like")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
