"""Find contacts in an XTF log with OpenCV alone: median per range, blur, threshold, connected components.

The chain is measured against this in time and in error, so it shares no code with it and takes every short cut that a
script of an afternoon takes: recorded numbers as they are, a flat floor at the altitude of the log, one pass over each
side as a single picture. Usage: python plain_script.py LOG.xtf CONTACTS.geojson
"""

from __future__ import annotations

import json
import math
import struct
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

BLUR = (3, 5)  # pings, samples
BRIGHT, DARK = 1.8, 0.6  # of the median at that range
SHADOW_M = 0.8  # a shadow is looked for so far behind the highlight, and over as much
SMALLEST_PX, LARGEST_PX = 6, 2000
EVEN_RATIO = 7.0  # of highlight to shadow, at which the score is 0.5


def read_xtf(path: str) -> tuple[Any, dict[int, Any], float]:
    """Read poses (n, 4) latitude, longitude, heading, altitude; samples per channel (n, n_samples); slant range, m."""
    data = Path(path).read_bytes()
    sides: dict[int, list[Any]] = {0: [], 1: []}
    position, poses, range_m = 1024, [], 0.0
    dtype: dict[int, str] = {1: "u1", 2: "<u2", 4: "<f4"}
    while position + 256 <= len(data):
        magic, kind, _, n_channels, n_bytes = struct.unpack_from("<HBBH4xI", data, position)
        if magic != 0xFACE or n_bytes == 0:
            break
        if kind == 0 and n_channels == 2:
            latitude, longitude = struct.unpack_from("<dd", data, position + 160)
            altitude, heading = struct.unpack_from("<f12xf", data, position + 196)
            poses.append((latitude, longitude, heading, altitude))
            at = position + 256
            for side in (0, 1):
                range_m = struct.unpack_from("<f", data, at + 4)[0]
                n_samples = struct.unpack_from("<I", data, at + 42)[0]
                width = data[256 + 128 * side + 6]  # bytes per sample, in the file header
                sides[side].append(np.frombuffer(data, dtype[width], n_samples, at + 64))
                at += 64 + n_samples * width
        position += n_bytes
    shape = min(len(row) for rows in sides.values() for row in rows)
    # Port is stored from far to near.
    port = np.stack([row[::-1][:shape] for row in sides[0]]).astype(np.float32)
    return np.array(poses), {-1: port, 1: np.stack([row[:shape] for row in sides[1]]).astype(np.float32)}, range_m


def contacts_of(samples: Any, poses: Any, spacing_m: float, side: int) -> list[dict[str, Any]]:
    """Find what is bright and has something dark behind; positions from the pose of the ping and a flat floor."""
    level = samples / np.maximum(np.median(samples[::4], axis=0), 1.0)
    smooth = cv2.blur(level, BLUR[::-1])
    lag = max(1, round(SHADOW_M / spacing_m))
    behind = np.roll(cv2.blur(level, (lag, BLUR[0])), -lag, axis=1)
    count, labels, boxes, centres = cv2.connectedComponentsWithStats((smooth > BRIGHT).astype(np.uint8))
    found = []
    for label in range(1, count):
        left, top, width, height, area = boxes[label]
        ping, sample = int(centres[label][1]), centres[label][0]
        latitude, longitude, heading, altitude = poses[ping]
        slant_m = sample * spacing_m
        if (
            not SMALLEST_PX <= area <= LARGEST_PX
            or slant_m < 1.1 * altitude
            or left + width + 2 * lag >= level.shape[1]
        ):
            continue
        own = labels[top : top + height, left : left + width] == label
        shadow = float(behind[top : top + height, left : left + width][own].min())
        if shadow > DARK:
            continue
        ratio = float(smooth[top : top + height, left : left + width][own].max()) / max(shadow, 1e-3)
        ground_m, turned = math.sqrt(slant_m**2 - altitude**2) * side, math.radians(heading)
        north_m, east_m = -ground_m * math.sin(turned), ground_m * math.cos(turned)
        place = [longitude + east_m / (111_320.0 * math.cos(math.radians(latitude))), latitude + north_m / 111_320.0]
        geometry = {"type": "Point", "coordinates": place}
        found.append({"type": "Feature", "geometry": geometry, "properties": {"p_mine": ratio / (ratio + EVEN_RATIO)}})
    return found


def find_contacts(log: str, contacts: str) -> None:
    """Read the log, write the contacts."""
    poses, sides, range_m = read_xtf(log)
    found = [
        one for side, samples in sides.items() for one in contacts_of(samples, poses, range_m / samples.shape[1], side)
    ]
    Path(contacts).write_text(json.dumps({"type": "FeatureCollection", "features": found}))


if __name__ == "__main__":
    cv2.setNumThreads(1)
    find_contacts(*sys.argv[1:])
