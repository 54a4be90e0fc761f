"""Train the verifier's network on chips and write it as ONNX. Needs PyTorch, the extra `verifier`."""

from __future__ import annotations

import copy
import io
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.classify.chips import N_COLUMNS, N_HEIGHTS, N_PLACE, N_ROWS
from auv_mcm.classify.verifier import CLASSES
from auv_mcm.errors import UsageError

N_EPOCHS: Final = 12
"""Passes over the chips. 12 by 512 find .82 of mines at 100 false alarms per km² on named scenes, 6 by 128 .80."""
_BATCH: Final = 512  # chips per step
_N_PARTS: Final = 2  # of a step, computed side by side: as many as there are cores
_RATE: Final = 4e-3  # highest learning rate, of a single cycle (L. N. Smith and N. Topin, SPIE 11006, 2019)
_GOING_ON: Final = 0.1  # of it for a network that is trained already
_DECAY: Final = 1e-2  # of weights (I. Loshchilov and F. Hutter, ICLR 2019)
_DROPPED: Final = 0.3  # share of the last layers' inputs left out in training
_KEPT: Final = 0.998  # of the averaged weights per step: a mean over some 500 steps
_SHIFT_PX: Final = 2  # that training chips are moved, maximum: what the detector's centre is off
_GAIN: Final = 0.15  # standard deviation of level and of contrast, in spreads of the floor
_FILLED: Final = 0.25  # share of training chips whose dark pixels are filled, as by echoes off other paths
_SMEARED: Final = 0.25  # share of training chips whose speckle is correlated further
_BENT: Final = 0.2  # standard deviation of ln(contrast) above and below the floor's middle: palettes, compressions
_CLIPPED: Final = 0.15  # share of training chips that the recorder clips
_CLIP: Final = (1.5, 5.0)  # spreads above the floor's middle where it does
_SEED: Final = 43  # fixed, so that weights repeat on one computer


class ChipTable(NamedTuple):
    """Hold n chips.

    metres: (n, N_ROWS, N_COLUMNS), heights: (n, N_ROWS, N_HEIGHTS), float16. place: (n, N_PLACE) float32. label: (n,)
    int8, index into CLASSES.
    """

    metres: NDArray[np.float16]
    heights: NDArray[np.float16]
    place: NDArray[np.float32]
    label: NDArray[np.int8]

    def at(self, chosen: NDArray[Any]) -> ChipTable:
        """Take the chosen chips."""
        return ChipTable(*(part[chosen] for part in self))


def train(
    chips: ChipTable,
    n_epochs: int = N_EPOCHS,
    seed: int = _SEED,
    start: Any = None,
    show: Callable[[int, float, Any], None] = lambda epoch, loss, network: None,
) -> Any:
    """Train a network to separate CLASSES; returns it with averaged weights, a torch.nn.Module.

    Parameters
    ----------
    start
        Network to go on from, as `started_from` makes it, at a tenth of the learning rate; None trains from nothing.
    show
        Takes each epoch's number and mean log-loss, and the averaged network.

    Raises
    ------
    UsageError
        Without PyTorch.
    """
    torch = _torch()
    torch.set_num_threads(1)  # of a part: the same sums with any number of cores
    torch.manual_seed(seed)
    random, *by_part = (np.random.Generator(np.random.PCG64([seed, k])) for k in range(1 + _N_PARTS))
    network = (network_of() if start is None else start).to(memory_format=torch.channels_last)  # a quarter faster
    averaged = copy.deepcopy(network).eval()
    copies = [network, *(_sharing_weights(network) for _ in range(_N_PARTS - 1))]
    for number, layer in enumerate(layer for one in copies for layer in one.modules() if hasattr(layer, "random")):
        layer.random = torch.Generator().manual_seed(seed + number)
    steps = -(-len(chips.label) // _BATCH)
    rate = _RATE if start is None else _GOING_ON * _RATE
    optimiser = torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=_DECAY)
    cycle = torch.optim.lr_scheduler.OneCycleLR(optimiser, max_lr=rate, total_steps=n_epochs * steps, pct_start=0.2)
    with ThreadPoolExecutor(_N_PARTS, initializer=torch.set_flush_denormal, initargs=(True,)) as pool:  # a third faster
        for epoch in range(n_epochs):
            total = 0.0
            for chosen in np.array_split(random.permutation(len(chips.label)), steps):
                parts = [chips.at(np.sort(part)) for part in np.array_split(chosen, _N_PARTS)]
                total += sum(pool.map(_set_gradients, copies, parts, by_part, [len(chosen)] * _N_PARTS))
                for weight, *others in zip(*(one.parameters() for one in copies), strict=True):
                    weight.grad = sum((other.grad for other in others), start=weight.grad)
                optimiser.step()
                cycle.step()
                _average(averaged, network, min(_KEPT, 1.0 - 1.0 / (1.0 + cycle.last_epoch)))
            show(epoch + 1, total / len(chips.label), averaged)
    return averaged


def _sharing_weights(network: Any) -> Any:
    """Copy a network: the same weights, gradients and statistics of its own."""
    twin = copy.deepcopy(network)
    for own, shared in zip(twin.parameters(), network.parameters(), strict=True):
        own.data = shared.data
    return twin


def _set_gradients(network: Any, chips: ChipTable, random: np.random.Generator, n_chips: int) -> float:
    """Set the gradients of a part's share in the log-loss of a step of n_chips; returns the sum over the part."""
    torch = _torch()
    network.train()
    network.zero_grad()
    wanted = torch.from_numpy(chips.label.astype(np.int64))
    scores = network(*(torch.from_numpy(each) for each in varied(chips, random)))
    loss = torch.nn.functional.cross_entropy(scores, wanted, label_smoothing=0.02, reduction="sum")
    (loss / n_chips).backward()
    return float(loss.detach())


def network_of() -> Any:
    """Lay out the layers, a torch.nn.Module of some 360,000 weights: a tower of convolutions for either picture."""
    torch = _torch()
    nn = torch.nn

    class Dropout(nn.Module):  # type: ignore[misc, name-defined]  # of an untyped package
        """Leave out inputs in training by random numbers of its own: PyTorch's are shared by threads."""

        random = torch.Generator()

        def forward(self, inputs: Any) -> Any:
            if not self.training:
                return inputs
            kept = torch.empty_like(inputs).bernoulli_(1.0 - _DROPPED, generator=self.random)
            return inputs * kept / (1.0 - _DROPPED)

    def tower(columns: int) -> Any:
        layers = [nn.Conv2d(1, 16, 4, stride=2, padding=1, bias=False), nn.BatchNorm2d(16), nn.ReLU()]
        for n_in, n_out, pools in ((16, 16, True), (16, 32, False), (32, 48, True), (48, 64, False)):
            layers += [nn.Conv2d(n_in, n_out, 3, padding=1, bias=False), nn.BatchNorm2d(n_out), nn.ReLU()]
            layers += [nn.MaxPool2d(2)] if pools else []
        n_left = 64 * (N_ROWS // 8) * (columns // 8)
        return nn.Sequential(*layers, nn.Flatten(), Dropout(), nn.Linear(n_left, 64), nn.ReLU())

    class Verifier(nn.Module):  # type: ignore[misc, name-defined]  # of an untyped package
        def __init__(self) -> None:
            super().__init__()
            self.metres, self.heights = tower(N_COLUMNS), tower(N_HEIGHTS)
            self.joined = nn.Sequential(nn.Linear(128 + N_PLACE, 64), nn.ReLU(), Dropout(), nn.Linear(64, len(CLASSES)))

        def forward(self, metres: Any, heights: Any, place: Any) -> Any:
            return self.joined(torch.cat([self.metres(metres), self.heights(heights), place], dim=1))

    return Verifier()


def started_from(onnx: bytes) -> Any:
    """Read the network of an ONNX file of `written_as_onnx`, a torch.nn.Module to train on.

    Its normalisations are part of the convolutions' weights there, and stay so.
    """
    import onnx as format_of_it

    torch = _torch()
    nn, network = torch.nn, network_of()
    for tower in (network.metres, network.heights):
        for index, layer in enumerate(tower):
            if isinstance(layer, nn.BatchNorm2d):
                tower[index] = nn.Identity()
            elif isinstance(layer, nn.Conv2d):
                size = layer.kernel_size, layer.stride, layer.padding
                tower[index] = nn.Conv2d(layer.in_channels, layer.out_channels, *size)
    graph = format_of_it.load_model_from_string(onnx).graph
    values = {one.name: format_of_it.numpy_helper.to_array(one) for one in graph.initializer}
    layers = [layer for layer in network.modules() if isinstance(layer, nn.Conv2d | nn.Linear)]
    nodes = [node for node in graph.node if node.op_type in ("Conv", "Gemm")]
    for layer, node in zip(layers, nodes, strict=True):
        for own, name in zip((layer.weight, layer.bias), node.input[1:], strict=True):
            own.data = torch.from_numpy(values[name].copy()).reshape(own.shape)
    return network


def written_as_onnx(network: Any) -> bytes:
    """Write the network as ONNX, for any number of chips at once."""
    torch = _torch()
    network.eval()
    file = io.BytesIO()
    example = (torch.zeros(1, 1, N_ROWS, N_COLUMNS), torch.zeros(1, 1, N_ROWS, N_HEIGHTS), torch.zeros(1, N_PLACE))
    names = ["metres", "heights", "place"]
    with warnings.catch_warnings():
        # PyTorch calls this exporter the older one; the newer needs further packages.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            network,
            example,
            file,
            input_names=names,
            output_names=["scores"],
            dynamic_axes={name: {0: "n"} for name in (*names, "scores")},
            dynamo=False,
        )
    return file.getvalue()


def varied(
    chips: ChipTable, random: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Vary chips as other passes, sonars and recorders would show the same places.

    Mirrored along the track, moved, brighter or fainter; contrasts bent and clipped; shadows filled; speckle smeared
    along the track or across.
    Returns pictures (n, 1, rows, columns) and places (n, N_PLACE).
    """
    n = len(chips.label)
    pictures = [chips.metres.astype(np.float32), chips.heights.astype(np.float32)]
    mirrored = random.random(n) < 0.5
    rows, columns = random.integers(-_SHIFT_PX, _SHIFT_PX + 1, size=2)
    offset, scale = random.normal(scale=_GAIN, size=(n, 1, 1)), np.exp(random.normal(scale=_GAIN, size=(n, 1, 1)))
    filled, level = random.random((n, 1, 1)) < _FILLED, random.uniform(-3.0, -0.7, size=(n, 1, 1))
    bent = np.exp(random.normal(scale=_BENT, size=(2, n, 1, 1)))
    top = np.where(random.random((n, 1, 1)) < _CLIPPED, random.uniform(*_CLIP, size=(n, 1, 1)), np.inf)
    smeared, along = random.random(n) < _SMEARED, random.random() < 0.5
    for k, picture in enumerate(pictures):
        picture[mirrored] = picture[mirrored, ::-1]
        picture = np.roll(picture, (rows, columns if k == 0 else 0), axis=(1, 2))
        axis = 1 if along else 2
        sides = np.roll(picture[smeared], 1, axis=axis) + np.roll(picture[smeared], -1, axis=axis)
        picture[smeared] = 1.35 * (
            0.5 * picture[smeared] + 0.25 * sides
        )  # independent pixels keep 0.61 of their spread
        picture = np.minimum(np.where(picture > 0.0, bent[0], bent[1]) * picture, top)
        picture = np.where(filled, np.logaddexp(picture, level) - np.logaddexp(0.0, level), picture)
        pictures[k] = np.ascontiguousarray((scale * picture + offset)[:, None], dtype=np.float32)
    return pictures[0], pictures[1], chips.place + random.normal(scale=0.05, size=chips.place.shape).astype(np.float32)


def _average(averaged: Any, network: Any, kept: float) -> None:
    """Move averaged weights, and the statistics of their layers, towards the network's."""
    torch = _torch()
    with torch.no_grad():
        for mean, latest in zip(averaged.state_dict().values(), network.state_dict().values(), strict=True):
            if mean.dtype.is_floating_point:
                mean.lerp_(latest, 1.0 - kept)
            else:
                mean.copy_(latest)


def needs_packages() -> None:
    """Raise UsageError where what trains and writes a network is missing, before hours of flying."""
    _torch()
    import onnx  # noqa: F401


def _torch() -> Any:
    try:
        import torch
    except ImportError as error:
        raise UsageError("training needs PyTorch: python -m pip install 'auv-mcm[verifier]'") from error
    return torch
