"""Tests of the network that separates mines from other objects and floor."""

from hashlib import sha256
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.classify.chips import N_COLUMNS, N_HEIGHTS, N_PLACE, N_ROWS, Chip
from auv_mcm.classify.odds import MineOdds, Verification, configured_odds, shipped_odds
from auv_mcm.classify.verifier import CLASSES, FILE, mean_scores, network_of, opinions_of, parse_network, rest_ratio
from auv_mcm.errors import BadInputError
from auv_mcm.settings.config import parse_config
from tests.auv_mcm.classify.slow_network import slow_scores, weights_of

BOUND = 2e-3  # nats that another platform's arithmetic may move a score, and the slow oracle's in float64


def shipped_bytes() -> bytes:
    from importlib import resources

    return resources.files("auv_mcm.classify").joinpath(FILE).read_bytes()


def digest() -> str:
    weighed = shipped_odds("cascade").verifier
    assert weighed is not None
    return weighed.digest


def chips(n: int) -> list[Chip]:
    random = np.random.default_rng(7)
    return [
        Chip(
            random.normal(size=(N_ROWS, N_COLUMNS)).astype(np.float32),
            random.normal(size=(N_ROWS, N_HEIGHTS)).astype(np.float32),
            random.normal(size=N_PLACE).astype(np.float32),
        )
        for _ in range(n)
    ]


def test_the_shipped_file_is_small() -> None:
    assert len(shipped_bytes()) <= 2_000_000


def test_scores_are_those_of_its_layers() -> None:
    seen = chips(2)
    expected = slow_scores(weights_of(shipped_bytes()), seen)
    np.testing.assert_allclose(network_of(digest()).scores(seen), expected, atol=BOUND)


def test_a_chip_has_the_same_scores_alone_among_others_and_on_any_number_of_threads() -> None:
    network, seen = network_of(digest()), chips(70)
    together = network.scores(seen)
    n_threads = cv2.getNumThreads()
    try:
        for threads in (1, 2, 4):
            cv2.setNumThreads(threads)
            assert np.array_equal(network.scores(seen), together)
            assert np.array_equal(np.concatenate([network.scores([one]) for one in seen]), together)
            assert np.array_equal(
                np.concatenate([network.scores(seen[first : first + 7]) for first in range(0, 70, 7)]), together
            )
    finally:
        cv2.setNumThreads(n_threads)
    assert network.scores([]).shape == (0, len(CLASSES))


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "text"])
def test_a_damaged_file_is_refused(damage: str) -> None:
    data = shipped_bytes()
    damaged = {
        "cut": data[: len(data) // 2],
        "flipped": data[:5000] + bytes([data[5000] ^ 255]) + data[5001:],
        "empty": b"",
        "text": b"{}",
    }[damage]
    with pytest.raises(BadInputError, match=r"a\.onnx: SHA-256"):
        parse_network(damaged, "a.onnx", digest())


@pytest.mark.parametrize("data", [b"", b"{}", b"\x08\x07nothing"])
def test_what_is_no_network_is_refused(data: bytes) -> None:
    with pytest.raises(BadInputError, match=r"a\.onnx: no network"):
        parse_network(data, "a.onnx")


def configured(folder: Path, digest: str) -> MineOdds:
    """Odds of one's own, with a network in the same folder."""
    odds = shipped_odds("cascade")
    weighed = msgspec.structs.replace(odds.verifier, file=FILE, digest=digest)  # type: ignore[type-var]
    own = msgspec.structs.replace(odds, verifier=weighed, fitted_for="cascade")
    (folder / "odds.json").write_bytes(msgspec.json.encode(own))
    place = str(folder / "odds.json")
    text = f"detect: {{gate: none}}\nconfirm: {{odds: {place!r}}}\ncontacts: {{background: none}}"
    return configured_odds(parse_config(text, "own.yaml"), "cascade")


def test_odds_of_one_s_own_bring_their_network_along(tmp_path: Path) -> None:
    data = shipped_bytes() + b"\xf8\x07\x01"  # a field that nobody reads
    (tmp_path / FILE).write_bytes(data)
    found = configured(tmp_path, sha256(data).hexdigest()).verifier
    assert found is not None
    assert found.file == str(tmp_path / FILE)
    np.testing.assert_array_equal(
        network_of(found.digest, found.file).scores(chips(2)), network_of(digest()).scores(chips(2))
    )
    with pytest.raises(BadInputError, match=r"verifier\.onnx: SHA-256"):
        configured(tmp_path, digest())
    (tmp_path / FILE).unlink()
    with pytest.raises(BadInputError, match=r"verifier\.onnx: No such file.* Put the network of these odds there"):
        configured(tmp_path, "0" * 64)


def scores_of(*probabilities: float) -> NDArray[np.float64]:
    return np.asarray(np.log(np.maximum(np.array([probabilities]), 1e-300)) + 3.0)


def test_the_rest_is_other_objects_and_floor() -> None:
    even, unlikely = scores_of(0.3, 0.1, 0.1, 0.0, 0.0, 0.3, 0.2), scores_of(0.0, 0.1, 0.0, 0.0, 0.0, 0.6, 0.3)
    both = np.concatenate([even, unlikely])
    np.testing.assert_allclose(rest_ratio(both, 0.0), np.log([1.0, 0.1 / 0.9]), atol=1e-12)
    np.testing.assert_allclose(rest_ratio(both, np.log(2.0)), np.log([0.5 / 0.8, 0.1 / 1.5]))


def test_an_opinion_states_how_much_less_likely_each_kind_is_than_the_likeliest() -> None:
    (one,) = opinions_of(scores_of(0.2, 0.1, 0.05, 0.02, 0.01, 0.32, 0.3), 0.0)
    assert one.nats == pytest.approx(np.log(0.38 / 0.62))
    np.testing.assert_allclose(np.exp(one.kind_nats), [1.0, 0.5, 0.25, 0.1, 0.05])
    assert opinions_of(np.empty((0, len(CLASSES))), 0.0) == []


def test_an_average_is_of_the_probabilities_logarithms_whatever_constant_scores_have() -> None:
    one, other = scores_of(0.2, 0.1, 0.1, 0.05, 0.05, 0.3, 0.2), scores_of(0.4, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1)
    mean = mean_scores(np.concatenate([one, other]), np.concatenate([other + 3.0, one - 2.0]))
    np.testing.assert_allclose(mean, np.repeat(0.5 * (one + other) - 3.0, 2, axis=0))
    np.testing.assert_allclose(mean_scores(one + 7.0, one), one - 3.0)


def test_verdicts_change_the_verifier_s_log_odds_as_all_others() -> None:
    weights = Verification(digest="0" * 64, offset=-0.4, detector=0.6, network=0.9, other_nats=0.0)
    slope, offset = 0.8, -0.3
    changed = weights.recalibrated(slope, offset)
    for detector, network in ((-3.0, 2.0), (1.5, -4.0)):
        expected = offset + slope * weights.log_odds(detector, network)
        assert changed.log_odds(offset + slope * detector, network) == pytest.approx(expected)
