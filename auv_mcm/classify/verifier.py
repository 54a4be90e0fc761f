"""Separate kinds of mines, other objects and sea floor by a small convolutional network on chips.

Two towers of convolutions, one for either picture of a chip, are joined with the place (Y. LeCun et al., Proceedings of
the IEEE 86, 1998). OpenCV runs it, many chips at a time. How its scores are weighed beside the detector's measurements
is part of the odds: see `auv_mcm.classify.odds`.
"""

from __future__ import annotations

import functools
import hashlib
import threading
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.chips import N_COLUMNS, N_HEIGHTS, N_PLACE, N_ROWS, Chip
from auv_mcm.errors import BadInputError
from auv_mcm.safe_files import read_regular

MINE_KINDS: Final = ("cylinder", "sphere", "truncated_cone", "wedge", "box")
"""Kinds of mines that the network separates."""
CLASSES: Final = (*MINE_KINDS, "other object", "floor")
"""What the network separates, in the order of its scores."""
FILE: Final = "verifier.onnx"
"""Name of the network's file."""
N_TOGETHER: Final = 64
"""Chips scored at once; more save no time."""

Scores = NDArray[np.float64]


class Network(NamedTuple):
    """Hold a network. digest: SHA-256 of its file. One thread runs it at a time."""

    digest: str
    net: cv2.dnn.Net
    lock: threading.Lock

    def scores(self, chips: Sequence[Chip]) -> Scores:
        """Score chips, (n, len(CLASSES)): logarithms of the probabilities of the classes but for a constant.

        The same for each chip, however many are scored together.
        """
        found = [np.empty((0, len(CLASSES)))]
        for first in range(0, len(chips), N_TOGETHER):
            part = chips[first : first + N_TOGETHER]
            with self.lock:
                self.net.setInput(np.stack([chip.by_metres for chip in part])[:, np.newaxis], "metres")
                self.net.setInput(np.stack([chip.by_height for chip in part])[:, np.newaxis], "heights")
                self.net.setInput(np.stack([chip.place for chip in part]), "place")
                found.append(np.array(self.net.forward(), dtype=np.float64))
        return np.concatenate(found)


def parse_network(data: bytes, place: str, digest: str | None = None) -> Network:
    """Read a network of an ONNX file.

    Raises BadInputError naming `place`: for another SHA-256 than `digest`, for a file that OpenCV cannot read, and for
    a network of other chips.
    """
    found = hashlib.sha256(data).hexdigest()
    if digest is not None and found != digest:
        raise BadInputError(f"{place}: SHA-256 {found}, not {digest}: it is damaged or of other odds. Install it again")
    advice = f"Install OpenCV 5, here is {cv2.__version__}, or write it again with 'auv-mcm calibrate verifier'"
    try:
        net = cv2.dnn.readNetFromONNX(np.frombuffer(data, dtype=np.uint8))
        network = Network(found, net, threading.Lock())
        shape = network.scores([_EMPTY]).shape
    except cv2.error as error:
        raise BadInputError(f"{place}: no network that OpenCV reads ({error.err}). {advice}") from error
    if shape != (1, len(CLASSES)):
        raise BadInputError(f"{place}: scores of shape {shape}, not (1, {len(CLASSES)}). {advice}")
    return network


@functools.cache
def network_of(digest: str, file: str = "") -> Network:
    """Load a network from its file, or the one that ships with the package, once in a process.

    Raises BadInputError for a file that cannot be read, is not a network, or has another digest.
    """
    if not file:
        return parse_network(resources.files("auv_mcm.classify").joinpath(FILE).read_bytes(), FILE, digest)
    try:
        return parse_network(read_regular(Path(file)), file, digest)
    except OSError as error:
        raise BadInputError(f"{file}: {error.strerror}. Put the network of these odds there again") from error


class Opinion(NamedTuple):
    """Hold what the network says of a chip.

    nats: ln(p(mine) / p(anything else)). kind_nats: of MINE_KINDS, logarithms of their probabilities over that of the
    likeliest.
    """

    nats: float
    kind_nats: tuple[float, ...]


NO_OPINION: Final = Opinion(0.0, (0.0,) * len(MINE_KINDS))
"""What is said of a detection that no chip can be cut of."""


def opinions_of(scores: Scores, other_nats: float) -> list[Opinion]:
    """Turn scores (n, len(CLASSES)) into opinions; other_nats as in `rest_ratio`."""
    kinds = scores[:, : len(MINE_KINDS)]
    kinds = kinds - kinds.max(axis=1, initial=-np.inf, keepdims=True)
    nats = rest_ratio(scores, other_nats)
    return [Opinion(one, tuple(row)) for one, row in zip(nats.tolist(), kinds.tolist(), strict=True)]


def mean_scores(scores: Scores, beside: Scores) -> Scores:
    """Average the scores of chips, (n, len(CLASSES)), with those of as many more that show the same, (k * n, ...).

    One opinion then hangs less on where the highlight's middle was taken to be: on ten named scenes Pd is .78 for .75
    at 100 false alarms per km², .67 for .62 with other objects counted.
    """
    each = np.concatenate([scores[:, np.newaxis], beside.reshape(len(scores), -1, len(CLASSES))], axis=1)
    return np.asarray((each - np.logaddexp.reduce(each, axis=2, keepdims=True)).mean(axis=1))


def rest_ratio(scores: Scores, other_nats: float) -> Scores:
    """Compute ln(p(mine) / p(anything else)), (n,), from scores (n, len(CLASSES)).

    other_nats: added to the score of other objects, which are rarer or more frequent than in training.
    """
    mine = np.logaddexp.reduce(scores[:, : len(MINE_KINDS)], axis=1)
    other, floor = scores[:, len(MINE_KINDS) :].T
    return np.asarray(mine - np.logaddexp(other + other_nats, floor))


_EMPTY: Final = Chip(
    np.zeros((N_ROWS, N_COLUMNS), dtype=np.float32),
    np.zeros((N_ROWS, N_HEIGHTS), dtype=np.float32),
    np.zeros(N_PLACE, dtype=np.float32),
)
