"""Run the verifier's layers by plain sums, from the weights in its ONNX file: an oracle without OpenCV or PyTorch."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.chips import Chip

Floats = NDArray[np.float64]


def weights_of(data: bytes) -> dict[str, Floats]:
    """Read the initialisers of an ONNX model: field 7 of the model is its graph, field 5 of that a tensor."""
    graph = next(value for field, value in _fields(data) if field == 7 and isinstance(value, bytes))
    found = {}
    for field, tensor in _fields(graph):
        if field == 5 and isinstance(tensor, bytes):
            parts = list(_fields(tensor))
            shape = [int(value) for number, value in parts if number == 1]
            name = next(value.decode() for number, value in parts if number == 8 and isinstance(value, bytes))
            raw = next(value for number, value in parts if number == 9 and isinstance(value, bytes))
            found[name] = np.frombuffer(raw, dtype="<f4").astype(np.float64).reshape(shape)
    return found


def slow_scores(weights: dict[str, Floats], chips: Sequence[Chip]) -> Floats:
    """Return (n, len(CLASSES))."""
    return np.array([_scores(weights, chip) for chip in chips])


def _scores(weights: dict[str, Floats], chip: Chip) -> Floats:
    convolutions = [value for value in weights.values() if value.ndim == 4]
    biases = [value for name, value in weights.items() if value.ndim == 1 and "bias" not in name]
    halves = len(convolutions) // 2
    towers = []
    for k, (name, picture) in enumerate((("metres", chip.by_metres), ("heights", chip.by_height))):
        own = list(zip(convolutions, biases, strict=True))[k * halves : (k + 1) * halves]
        x = picture[np.newaxis].astype(np.float64)
        for layer, (kernel, bias) in enumerate(own):
            x = np.maximum(_convolved(x, kernel, 2 if layer == 0 else 1) + bias[:, None, None], 0.0)
            x = _pooled(x) if layer in (1, 3) else x
        dense = next(
            part for part in weights if part.startswith(name) and part.endswith("weight") and weights[part].ndim == 2
        )
        towers.append(np.maximum(weights[dense] @ x.ravel() + weights[dense.replace("weight", "bias")], 0.0))
    x = np.concatenate([*towers, chip.place.astype(np.float64)])
    x = np.maximum(weights["joined.0.weight"] @ x + weights["joined.0.bias"], 0.0)
    return np.asarray(weights["joined.3.weight"] @ x + weights["joined.3.bias"])


def _convolved(x: Floats, kernel: Floats, stride: int) -> Floats:
    size = kernel.shape[-1]
    padded = np.pad(x, ((0, 0), (1, 1), (1, 1)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (size, size), axis=(1, 2))[:, ::stride, ::stride]
    return np.asarray(np.einsum("ihwab,oiab->ohw", windows, kernel))


def _pooled(x: Floats) -> Floats:
    n, rows, columns = x.shape
    cut = x[:, : rows // 2 * 2, : columns // 2 * 2]
    return np.asarray(cut.reshape(n, rows // 2, 2, columns // 2, 2).max(axis=(2, 4)))


def _fields(data: bytes) -> Iterator[tuple[int, bytes | int]]:
    """Iterate over the fields of a protocol-buffer message: number, and bytes or whole number."""
    place = 0

    def whole() -> int:
        nonlocal place
        value = shift = 0
        while True:
            byte = data[place]
            place += 1
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    while place < len(data):
        key = whole()
        if key & 7 == 0:
            yield key >> 3, whole()
        else:
            length = whole() if key & 7 == 2 else {1: 8, 5: 4}[key & 7]
            yield key >> 3, data[place : place + length]
            place += length
