"""Draw the sonar picture that lies under the map of the page, small enough for it."""

from __future__ import annotations

from typing import Final, NamedTuple

import cv2

from sim_replay.mosaic import Box, Mosaic
from sim_replay.mosaic_files import coloured

RESOLUTION_M: Final = 0.25
"""Pixel of the picture, m, doubled until the mission fits: to 0.5 m for 40 minutes of 50 m range on either side."""
MAX_BLOCKS: Final = 48  # blocks of sums in memory: 25 MB, and 3.1 million pixels
MAX_BYTES: Final = 650_000  # of the picture, 0.87 MB in the page, which stays below 5 MB for 40 minutes
_MAX_SIDE: Final = 4096  # pixels, which browsers on small computers still show
_QUALITIES: Final = (70, 50, 35)  # of WebP: speckle takes most of the bytes and loses nothing that can be seen


class MapPicture(NamedTuple):
    """Hold a WebP picture, transparent where nothing was seen, and its outline."""

    webp: bytes
    box: Box


def map_picture(mosaic: Mosaic) -> MapPicture | None:
    """Encode the mosaic at the finest resolution within MAX_BYTES, None for an empty one. The mosaic is used up."""
    for level in mosaic.levels():
        if max(level.width, level.height) > 2 * _MAX_SIDE:
            continue
        drawn, box = level.picture()
        if not drawn.size or max(drawn.shape) > _MAX_SIDE:
            continue
        picture = coloured(drawn)
        for quality in _QUALITIES:
            done, data = cv2.imencode(".webp", picture, [cv2.IMWRITE_WEBP_QUALITY, quality])
            if done and len(data) <= MAX_BYTES:
                return MapPicture(bytes(data), box)
    return None
