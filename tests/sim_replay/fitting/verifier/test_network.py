"""Tests of the convolutional verifier."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sim_replay.fitting.verifier.chips import N_COLUMNS, N_PLANES, N_ROWS
from sim_replay.fitting.verifier.network import log_odds_of_chips, network_of, read_network, train, written_as_onnx

torch: Any = pytest.importorskip("torch", reason="the extra `verifier` is not installed")


def drawn(n: int, seed: int) -> tuple[NDArray[np.float16], NDArray[np.bool_]]:
    """Draw chips of speckle, every fourth with a bright patch and a shadow."""
    random = np.random.Generator(np.random.PCG64(seed))
    chips = random.normal(scale=0.4, size=(n, N_PLANES, N_ROWS, N_COLUMNS))
    is_target = np.arange(n) % 4 == 0
    chips[is_target, :2, 10:14, 10:13] += 0.8
    chips[is_target, :2, 10:14, 13:20] -= 0.8
    return chips.astype(np.float16), is_target


def test_a_network_learns_echo_and_shadow_beside_speckle_and_repeats_itself() -> None:
    chips, is_target = drawn(256, seed=1)
    onnx = train(chips, is_target, np.ones(len(chips)), n_epochs=4)
    others, truth = drawn(64, seed=2)
    log_odds = log_odds_of_chips(read_network(onnx), others)
    assert log_odds[truth].min() > log_odds[~truth].max()
    again = train(chips, is_target, np.ones(len(chips)), n_epochs=4)
    assert log_odds_of_chips(read_network(again), others) == pytest.approx(log_odds, abs=1e-6)


def test_opencv_scores_chips_as_pytorch_does_alone_and_together() -> None:
    torch.manual_seed(3)
    network = network_of(0.2)
    chips, _ = drawn(20, seed=3)
    served = read_network(written_as_onnx(network))
    network.eval()
    with torch.no_grad():
        expected = network(torch.from_numpy(chips.astype(np.float32)))[:, 0].numpy()
    assert log_odds_of_chips(served, chips) == pytest.approx(expected, abs=1e-4)
    assert log_odds_of_chips(served, chips[:1]) == pytest.approx(expected[:1], abs=1e-4)
    assert log_odds_of_chips(served, chips[:0]).shape == (0,)
