"""A target at a known latitude and longitude must be reported there, whatever the geometry of the pass."""

from __future__ import annotations

import math

from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from auv_mcm.model_file import NONE
from auv_mcm.pipeline import Pipeline
from auv_mcm.settings.config import Config, ContactsConfig, DetectConfig, SonarConfig
from sim_replay.simulator.mission import Mission
from sim_replay.simulator.scene import STEADY, SampleRecorder, Scene, SceneObject, Sonar
from tests.auv_mcm.short_missions import one_leg

WGS84_A_M, WGS84_F = 6378137.0, 1.0 / 298.257223563
TOLERANCE_M = 0.3
POINT_DB = -5.0  # target strength that stands out of sand at any range asked for


def distance_m(latitude_a: float, longitude_a: float, latitude_b: float, longitude_b: float) -> float:
    """Short geodesic distance from the radii of curvature at the middle: independent of the code under test, 1e-6 m at
    100 m."""
    middle = math.radians(0.5 * (latitude_a + latitude_b))
    e2 = WGS84_F * (2.0 - WGS84_F)
    w = math.sqrt(1.0 - e2 * math.sin(middle) ** 2)
    north = math.radians(latitude_a - latitude_b) * WGS84_A_M * (1.0 - e2) / w**3
    east = math.radians(math.remainder(longitude_a - longitude_b, 360.0)) * WGS84_A_M / w * math.cos(middle)
    return math.hypot(north, east)


def closest_contact_m(scene: Scene) -> float:
    sonar = SonarConfig(beam_width_deg=scene.sonar.beam_width_deg)
    # A point casts no shadow: the cascade, which was trained on mines, does not see it.
    pipeline = Pipeline(Config(sonar=sonar, detect=DetectConfig(model=NONE), contacts=ContactsConfig(min_p_mine=0.0)))
    mission = Mission(scene)
    for event in mission.events():
        pipeline.feed(event)
    pipeline.finish()
    target = mission.truth()["objects"][0]
    strong = [contact for contact in pipeline.contacts if contact.views[0].score > 4.2]
    return min(
        (distance_m(c.latitude_deg, c.longitude_deg, target["lat"], target["lon"]) for c in strong), default=math.inf
    )


@settings(max_examples=8, phases=(Phase.explicit, Phase.generate))  # a mission is too slow to shrink
@given(
    ground_range_m=st.floats(10.0, 75.0),
    altitude_m=st.floats(2.0, 20.0),
    heading_deg=st.floats(0.0, 360.0),
    pitch_deg=st.floats(-10.0, 10.0),
    latitude_deg=st.floats(-80.0, 80.0),
    longitude_deg=st.floats(-180.0, 179.99),
    to_starboard=st.booleans(),
    seed=st.integers(0, 1000),
)
@example(10.0, 20.0, 0.0, 10.0, 48.4, -68.8, True, 1)
@example(75.0, 2.0, 359.0, -10.0, 48.4, -68.8, False, 2)
@example(75.0, 20.0, 180.0, 10.0, -70.0, 179.9, True, 3)
@example(10.0, 2.0, 90.0, 0.0, 0.5, 0.0, False, 4)
def test_point_target_is_reported_within_a_third_of_a_metre(
    ground_range_m: float,
    altitude_m: float,
    heading_deg: float,
    pitch_deg: float,
    latitude_deg: float,
    longitude_deg: float,
    to_starboard: bool,
    seed: int,
) -> None:
    range_m = 1.1 * math.hypot(ground_range_m, altitude_m / math.cos(math.radians(pitch_deg))) + 4.0
    across_m = ground_range_m if to_starboard else -ground_range_m
    sonar = Sonar(
        range_m=range_m,
        n_samples=int(range_m / 0.05),
        ping_rate_hz=min(9.0, 700.0 / range_m),
        beam_width_deg=0.7,  # so that some ping sees the point at every range
        beam_lines=1,
        recorder=SampleRecorder(samples="amplitude_float32"),
    )
    scene = one_leg(
        [SceneObject(kind="point", leg=0, along_m=8.0, across_m=across_m, strength_db=POINT_DB)],
        sonar,
        length_m=16.0,
        altitude_m=altitude_m,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        heading_deg=heading_deg,
        speed_mps=0.9,
        motion=replace(STEADY, pitch_offset_deg=pitch_deg),
        seed=seed,
    )
    assert closest_contact_m(scene) < TOLERANCE_M
