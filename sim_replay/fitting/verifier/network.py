"""Train the convolutional verifier, write it as ONNX, and score chips with it by OpenCV.

Training needs PyTorch (the extra `verifier`); scoring needs OpenCV alone.
"""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Callable
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from sim_replay.fitting.verifier.chips import N_COLUMNS, N_PLANES, N_ROWS, Chip

N_EPOCHS: Final = 12
"""Passes over the chips, set before anything was judged. No mission is kept back to stop early."""
N_TOGETHER: Final = 256
"""Chips scored at once: 4 MB of them."""
_BATCH: Final = 128  # chips per step of training
_RATE: Final = 3e-3  # highest learning rate, of a single cycle (L. N. Smith and N. Topin, SPIE 11006, 2019)
_DECAY: Final = 1e-3  # of weights (I. Loshchilov and F. Hutter, ICLR 2019)
_DROPPED: Final = 0.2  # share of the last layer's inputs left out in training
_SHIFT_PX: Final = 1  # at most, that training chips are moved: what the detector's centre is off
_GAIN: Final = 0.1  # standard deviation of the level added to training chips: 1 dB
_SEED: Final = 22  # fixed, so that weights repeat on one computer


def train(
    chips: NDArray[np.float16],
    is_target: NDArray[np.bool_],
    weight: NDArray[np.float64],
    n_epochs: int = N_EPOCHS,
    show: Callable[[int, float], None] = lambda epoch, loss: None,
) -> bytes:
    """Train a network to give the log-odds of a target; returns it as ONNX.

    Parameters
    ----------
    chips
        (n, N_PLANES, N_ROWS, N_COLUMNS).
    is_target, weight
        (n,); how many looks each chip stands for.
    show
        Takes each epoch's number and mean log-loss.

    Raises
    ------
    UsageError
        Without PyTorch.
    """
    torch = _torch()
    torch.set_num_threads(1)  # sums in another order give other weights
    torch.manual_seed(_SEED)
    random = np.random.Generator(np.random.PCG64(_SEED))
    network = network_of(float(weight[is_target].sum() / weight.sum()))
    steps = -(-len(chips) // _BATCH)
    optimiser = torch.optim.AdamW(network.parameters(), lr=_RATE, weight_decay=_DECAY)
    cycle = torch.optim.lr_scheduler.OneCycleLR(optimiser, max_lr=_RATE, total_steps=n_epochs * steps)
    log_loss = torch.nn.BCEWithLogitsLoss(reduction="none")
    mean_weight = float(weight.mean())
    for epoch in range(n_epochs):
        network.train()
        total = 0.0
        for chosen in np.array_split(random.permutation(len(chips)), steps):
            batch = torch.from_numpy(_varied(chips[chosen].astype(np.float32), random))
            wanted = torch.from_numpy(is_target[chosen].astype(np.float32))
            weights = torch.from_numpy((weight[chosen] / mean_weight).astype(np.float32))
            loss = (weights * log_loss(network(batch)[:, 0], wanted)).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            cycle.step()
            total += float(loss.detach()) * len(chosen)
        show(epoch + 1, total / len(chips))
    return written_as_onnx(network)


def written_as_onnx(network: Any) -> bytes:
    """Write a torch.nn.Module as ONNX, for any number of chips at once."""
    torch = _torch()
    network.eval()
    file = io.BytesIO()
    example = torch.zeros(1, N_PLANES, N_ROWS, N_COLUMNS)
    any_number = {"chips": {0: "n"}, "log_odds": {0: "n"}}
    with warnings.catch_warnings():
        # PyTorch calls this exporter the older one; the newer needs further packages.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            network,
            (example,),
            file,
            input_names=["chips"],
            output_names=["log_odds"],
            dynamic_axes=any_number,
            dynamo=False,
        )
    return file.getvalue()


def read_network(onnx: bytes) -> cv2.dnn.Net:
    """Read a trained network, for `log_odds_of_chips`."""
    return cv2.dnn.readNetFromONNX(np.frombuffer(onnx, dtype=np.uint8))


def log_odds_of_chips(network: cv2.dnn.Net, chips: NDArray[np.float16] | Chip) -> NDArray[np.float64]:
    """Score chips by OpenCV; (n, N_PLANES, N_ROWS, N_COLUMNS) to log-odds (n,)."""
    found = []
    for first in range(0, len(chips), N_TOGETHER):
        network.setInput(np.ascontiguousarray(chips[first : first + N_TOGETHER], dtype=np.float32))
        found.append(np.asarray(network.forward(), dtype=np.float64)[:, 0])
    return np.concatenate(found) if found else np.empty(0)


def _torch() -> Any:
    try:
        import torch
    except ImportError as error:
        raise UsageError("training needs PyTorch: python -m pip install 'auv-mcm[verifier]'") from error
    return torch


def network_of(share_of_targets: float) -> Any:
    """Lay out the layers, a torch.nn.Module of 29,000 weights that begins with the share of targets for every chip."""
    nn = _torch().nn
    layers = [nn.BatchNorm2d(N_PLANES)]
    for n_in, n_out, pools in ((N_PLANES, 16, False), (16, 16, True), (16, 32, True), (32, 32, True)):
        layers += [nn.Conv2d(n_in, n_out, 3, padding=1), nn.BatchNorm2d(n_out), nn.ReLU()]
        layers += [nn.MaxPool2d(2)] if pools else []
    last = nn.Linear(32, 1)
    nn.init.constant_(last.bias, math.log(share_of_targets / (1.0 - share_of_targets)))
    n_left = 32 * (N_ROWS // 8) * (N_COLUMNS // 8)
    return nn.Sequential(*layers, nn.Flatten(), nn.Linear(n_left, 32), nn.ReLU(), nn.Dropout(_DROPPED), last)


def _varied(chips: Chip, random: np.random.Generator) -> Chip:
    """Mirror chips along the track, move them and change their level, as other pings would show the same places."""
    if random.random() < 0.5:
        chips = chips[:, :, ::-1]
    rows, columns = random.integers(-_SHIFT_PX, _SHIFT_PX + 1, size=2)
    moved = np.roll(chips[:, :2], (rows, columns), axis=(2, 3))
    gain = random.normal(scale=_GAIN, size=(len(chips), 1, 1, 1)).astype(np.float32)
    return np.ascontiguousarray(np.concatenate([moved + gain, chips[:, 2:]], axis=1))
