"""The gate before measuring: what it lets through, that it is monotonous, and that the one that ships keeps what would
be reported."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.detect.gate import Feature, Forecast, Values, may_reach, parse_gate, place_features, shipped_gate
from auv_mcm.errors import BadInputError

Place = tuple[float, float, float, float]
PLACES = st.lists(
    st.tuples(st.floats(-10.0, 10.0), st.floats(-5.0, 30.0), st.floats(0.1, 200.0), st.floats(0.1, 50.0)), min_size=1
)


def features_of(places: list[Place]) -> dict[Feature, Values]:
    cascade, contrast, ground_range_m, altitude_m = np.array(places).T
    return place_features(ground_range_m, altitude_m, cascade=cascade, contrast=contrast)


@given(places=PLACES, low=st.floats(0.0, 1.0), high=st.floats(0.0, 1.0))
def test_a_lower_minimum_lets_through_all_that_a_higher_one_does(places: list[Place], low: float, high: float) -> None:
    features = features_of(places)
    for forecast in (shipped_gate().both, shipped_gate().contrast):
        few, many = (may_reach(forecast, p, features) for p in sorted((low, high), reverse=True))
        assert (few <= many).all()


@given(places=PLACES)
def test_a_minimum_of_0_lets_everything_through(places: list[Place]) -> None:
    assert may_reach(shipped_gate().both, 0.0, features_of(places)).all()
    assert may_reach(None, 0.9, features_of(places)).all()


@given(places=PLACES, p=st.floats(0.001, 0.999))
def test_a_forecast_is_a_sum_and_the_margin_is_added_to_it(places: list[Place], p: float) -> None:
    forecast = Forecast(offset=-3.0, weights={"cascade": 1.5, "contrast": 0.5, "range": -1.0}, margin_nats=0.7)
    expected = []
    for cascade, contrast, ground_range_m, altitude_m in places:
        log_range = min(max(math.log(ground_range_m / altitude_m), -1.5), 3.5)
        expected.append(-3.0 + 1.5 * cascade + 0.5 * contrast - log_range)
    features = features_of(places)
    assert forecast.log_odds(features).tolist() == pytest.approx(expected, abs=1e-9)
    lowest = math.log(p / (1.0 - p))
    clear = [k for k, odds in enumerate(expected) if abs(odds + 0.7 - lowest) > 1e-6]
    reaching = may_reach(forecast, p, features)
    assert [bool(reaching[k]) for k in clear] == [expected[k] + 0.7 >= lowest for k in clear]


def test_a_place_without_altitude_is_judged_as_at_45_degrees() -> None:
    known = place_features(np.array([5.0]), np.array([5.0]), cascade=np.array([1.0]))
    unknown = place_features(np.array([5.0]), np.array([0.0]), cascade=np.array([1.0]))
    assert known == unknown


def test_a_damaged_gate_is_refused_with_its_place() -> None:
    with pytest.raises(BadInputError, match=r"gate.json: .*calibrate gate"):
        parse_gate(b'{"fitted_on": 3}', "gate.json")
