"""Learning kinds of sea floor, from made-up textures and from a short simulated mission."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.records import SEABED_TYPES
from auv_mcm.seabed.seabed_model import kind_indices, parse_seabed_model, seabed_odds
from auv_mcm.seabed.texture import NAMES
from auv_mcm.settings.config import Config
from sim_replay.fitting.seabed import fit_seabed as fitting
from sim_replay.fitting.seabed import samples as sampled
from sim_replay.fitting.seabed.fit_seabed import FIT_SEEDS, fit_seabed_model, seabed_fit_words
from sim_replay.fitting.seabed.samples import KINDS, SeabedSamples, pooled, samples_of
from sim_replay.fitting.seabed.seabed_missions import FIRST_LIKE_SCENE, KIND_OF, LIKE, mission_scene, sonar_config
from sim_replay.simulator.scene import Lawnmower, SampleRecorder, Scene, Seabed
from sim_replay.simulator.scene_file import read_scene

Array = NDArray[np.float64]


def made_up(n: int, seed: int) -> SeabedSamples:
    """Every kind somewhere else, some more often than others; every tenth cell lies on a border."""
    rng = np.random.Generator(np.random.PCG64(seed))
    middle = np.random.Generator(np.random.PCG64(0)).normal(0.0, 1.5, (len(KINDS), len(NAMES)))
    kind = rng.choice(len(KINDS), n, p=np.array([0.1, 0.2, 0.3, 0.4]))
    shares = np.eye(len(KINDS), dtype=np.float32)[kind]
    shares[::10] = 0.7 * shares[::10] + 0.3 * shares[(np.arange(n) + 1) % n][::10]
    features = (shares @ middle + rng.normal(size=(n, len(NAMES)))).astype(np.float32)
    return SeabedSamples(features, rng.uniform(0.5, 15.0, n).astype(np.float32), shares)


@pytest.fixture(autouse=True)
def _small_networks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fitting, "_HIDDEN", (8,))
    monkeypatch.setattr(fitting, "_EPOCHS", 60)


def test_kinds_that_differ_are_separated() -> None:
    model = fit_seabed_model(made_up(4000, 1), "made up")
    held_out = made_up(1000, 2)
    odds = seabed_odds(held_out.features.astype(np.float64), held_out.cot_grazing.astype(np.float64), model)
    whole = held_out.shares.max(axis=1) == 1.0
    found = kind_indices(model)[np.argmax(odds.log_p, axis=-1)]
    assert (found == np.array([SEABED_TYPES.index(kind) for kind in KINDS])[held_out.shares.argmax(axis=1)])[
        whole
    ].mean() > 0.97
    assert (odds.distance > model.learnt.novelty).mean() < 0.02
    far = seabed_odds(held_out.features.astype(np.float64) + 100.0, held_out.cot_grazing.astype(np.float64), model)
    assert (far.distance > model.learnt.novelty).all()


def test_a_model_survives_its_file_and_the_same_samples_make_the_same_bytes() -> None:
    first, again = (msgspec.json.encode(fit_seabed_model(made_up(1500, 3), "made up")) for _ in range(2))
    assert first == again
    assert msgspec.json.encode(parse_seabed_model(first, "m.json")) == first


def test_a_kind_that_is_missing_is_reported() -> None:
    some = made_up(1500, 4)
    kept = some.shares[:, KINDS.index("vegetation")] == 0.0
    with pytest.raises(BadInputError, match="too little of vegetation"):
        fit_seabed_model(SeabedSamples(*(part[kept] for part in some)), "made up")


def test_too_few_samples_are_reported() -> None:
    with pytest.raises(BadInputError, match="give more missions"):
        fit_seabed_model(made_up(40, 5), "made up")


def test_scenes_differ_by_seed_and_hold_two_kinds_at_least() -> None:
    assert mission_scene(1) == mission_scene(1)
    assert mission_scene(1) != mission_scene(2)
    scenes = [mission_scene(seed) for seed in range(60)]
    kinds = [{KIND_OF[seabed.type] for seabed in scene.world.seabeds} for scene in scenes]
    assert min(map(len, kinds)) == 2
    assert set.union(*kinds) == set(KINDS)
    assert len({scene.sonar.recorder.samples for scene in scenes}) == 5


def test_free_missions_are_none_of_the_named_scenes_and_others_are_like_one_in_turn() -> None:
    """What is learnt from free missions alone may be judged on scenes that it never saw."""
    for seed in range(FIRST_LIKE_SCENE, FIRST_LIKE_SCENE + len(LIKE)):
        scene, like = mission_scene(seed), read_scene(LIKE[seed % len(LIKE)])
        assert scene.sonar.recorder == like.sonar.recorder
        assert [seabed.type for seabed in scene.world.seabeds] == [seabed.type for seabed in like.world.seabeds]
        assert scene.seed == seed != like.seed
    named = [read_scene(name).sonar for name in LIKE]
    assert all(mission_scene(seed).sonar not in named for seed in range(60))
    assert len(set(FIT_SEEDS)) == len(FIT_SEEDS)
    assert min(FIT_SEEDS) < FIRST_LIKE_SCENE <= max(FIT_SEEDS) < 90_000


def test_decibels_per_count_are_known_as_well_as_an_estimate() -> None:
    scene = mission_scene(3)
    recorder = SampleRecorder(samples="log_uint8", db_per_count=0.3)
    some = [
        sonar_config(
            msgspec.structs.replace(scene, seed=seed, sonar=msgspec.structs.replace(scene.sonar, recorder=recorder))
        )
        for seed in range(40)
    ]
    assert {config.transfer for config in some} == {"log"}
    reported = [config.db_per_count or 0.0 for config in some]
    assert 0.24 <= min(reported) < 0.28 < 0.32 < max(reported) <= 0.375


def small_scene(seed: int) -> Scene:
    """Sand alone, seen for half a minute."""
    scene = mission_scene(seed)
    world = msgspec.structs.replace(scene.world, seabeds=(Seabed(type="sand"),), slope_deg=0.0)
    track = msgspec.structs.replace(scene.track, plan=Lawnmower(n_legs=1, leg_m=45.0, spacing_m=50.0), altitude_m=5.0)
    sonar = msgspec.structs.replace(scene.sonar, range_m=25.0, n_samples=500, ping_rate_hz=8.0, synthetic_aperture=None)
    return msgspec.structs.replace(scene, world=world, track=track, sonar=sonar, scatter=())


def test_cells_of_a_mission_are_what_the_simulator_put_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampled, "mission_scene", small_scene)
    reported = samples_of(11)
    assert len(reported.shares) > 20
    assert (reported.shares[:, KINDS.index("flat")] == 1.0).all()
    assert np.isfinite(reported.features).all()
    assert seabed_fit_words([11], pooled([reported]).shares).startswith("1 simulated missions of seeds 11 to 11, ")


def test_a_new_model_can_be_learnt_when_the_shipped_one_measures_something_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Calibration could not run after the names of textures had changed, since the pipeline read the shipped model
    first."""

    def refuse(config: Config) -> None:
        raise BadInputError("seabed/model.json: fitted on other textures")

    monkeypatch.setattr("auv_mcm.pipeline.configured_seabed_model", refuse)
    monkeypatch.setattr(sampled, "mission_scene", small_scene)
    assert len(samples_of(11).shares) > 20
