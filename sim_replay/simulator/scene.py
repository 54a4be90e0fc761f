"""Define the parts of a simulated mission.

Positions are in the local plane of `origin` (east and north in metres), directions in degrees clockwise from its north.
Every key but `track` has a default. `scene_file` reads scenes from YAML and refuses what cannot be.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal, TypeAlias

import msgspec
from msgspec import Meta

SeabedType: TypeAlias = Literal["mud", "sand", "rippled_sand", "gravel", "rock_outcrop", "boulder_field", "seagrass"]
TargetKind: TypeAlias = Literal["cylinder", "sphere", "truncated_cone", "wedge", "box"]
ObjectKind: TypeAlias = Literal[
    "cylinder",
    "sphere",
    "truncated_cone",
    "wedge",
    "box",
    "rock",
    "slab",
    "boulder_cluster",
    "debris",
    "tyre",
    "pipe",
    "anchor_scar",
    "fish_school",
    "point",
]
TARGET_KINDS: Final[frozenset[str]] = frozenset({"cylinder", "sphere", "truncated_cone", "wedge", "box"})

Direction = Annotated[float, Meta(ge=-360.0, le=720.0)]
Decibel = Annotated[float, Meta(ge=-100.0, le=100.0)]
Length = Annotated[float, Meta(ge=0.0, le=200.0)]
Tilt = Annotated[float, Meta(ge=-45.0, le=45.0)]  # degrees
SizeRange = tuple[Length, Length]
Frequency = Annotated[float, Meta(ge=10.0, le=3000.0)]  # kHz
MaxRange = Annotated[float, Meta(gt=1.0, le=1000.0)]  # m
Samples = Annotated[int, Meta(ge=64, le=20_000)]
PingRate = Annotated[float, Meta(gt=0.0, le=200.0)]  # Hz
BeamWidth = Annotated[float, Meta(gt=0.0, le=20.0)]  # degrees
RangeResolution = Annotated[float, Meta(ge=0.0, le=2.0)]  # m
InPlane = Annotated[float, Meta(ge=-50_000.0, le=50_000.0)]  # m: farther out the plane departs from the sea floor


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pass


class Origin(_Section, frozen=True, kw_only=True):
    """Fix the local plane's point of contact with the ellipsoid."""

    latitude_deg: Annotated[float, Meta(ge=-89.0, le=89.0)] = 43.0931
    longitude_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] = 5.8872


class Ripples(_Section, frozen=True, kw_only=True):
    """Describe ripples or sand waves.

    `direction_deg`: in which the crests follow one another. `defects`: 0 for endless straight crests, 1 for crests that
    bend and break within a few wavelengths. `skew`: 0 sinusoidal, 1 steep on the lee side.
    """

    wavelength_m: Annotated[float, Meta(ge=0.1, le=500.0)]
    height_m: Annotated[float, Meta(gt=0.0, le=10.0)]
    direction_deg: Direction = 0.0
    defects: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.3
    skew: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.4


class Seabed(_Section, frozen=True, kw_only=True):
    """Describe one kind of sea floor and its share of the area, in proportion to the other shares.

    A key left out keeps what is usual for the type.

    texture_shape: of the Gamma-distributed texture whose patches of texture_m make echoes K-distributed; 0 for none.
    stones_per_ha: number of stones longer than stone_m per hectare; their number above a length d falls as d^-2.5.
    level_db: added to the backscattering strength.
    """

    type: SeabedType
    share: Annotated[float, Meta(gt=0.0, le=1000.0)] = 1.0
    relief_rms_m: Annotated[float, Meta(ge=0.0, le=5.0)] | None = None
    ripples: Ripples | None = None
    texture_shape: Annotated[float, Meta(ge=0.0, le=1000.0)] | None = None
    texture_m: Annotated[float, Meta(ge=0.1, le=20.0)] | None = None
    stones_per_ha: Annotated[float, Meta(ge=0.0, le=20_000.0)] | None = None
    stone_m: Annotated[float, Meta(ge=0.05, le=5.0)] | None = None
    level_db: Annotated[float, Meta(ge=-30.0, le=30.0)] = 0.0


class World(_Section, frozen=True, kw_only=True):
    """Describe the sea floor.

    `depth_m`: of the datum plane. `patch_m`: size of the patches of different sea floor. `slope_deg`: the floor rises
    by it towards `slope_towards_deg`. `relief_*`: large forms under all types, a power-law spectrum up to
    relief_outer_m.
    """

    depth_m: Annotated[float, Meta(gt=0.5, le=6000.0)] = 20.0
    seabeds: Annotated[tuple[Seabed, ...], Meta(min_length=1, max_length=7)] = (Seabed(type="sand"),)
    patch_m: Annotated[float, Meta(ge=5.0, le=500.0)] = 60.0
    slope_deg: Annotated[float, Meta(ge=0.0, le=30.0)] = 0.0
    slope_towards_deg: Direction = 0.0
    relief_rms_m: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.05
    relief_outer_m: Annotated[float, Meta(ge=2.0, le=100.0)] = 30.0
    sand_waves: Ripples | None = None
    backscatter: Literal["apl_uw", "lambert"] = "apl_uw"
    cell_m: Annotated[float, Meta(ge=0.01, le=0.5)] = 0.05


class SceneObject(_Section, frozen=True, kw_only=True):
    """Describe something on or above the sea floor.

    It lies at east_m and north_m, or at latitude_deg and longitude_deg, or at along_m on the planned leg `leg` and
    across_m to starboard of it.

    Sizes left out are usual ones of the kind. cylinder, pipe: length, width = diameter. sphere: width = diameter.
    truncated_cone: width = base diameter, top_m = top diameter, height. wedge, box, rock, slab, debris: length,
    width, height. tyre: width = outer diameter, height = thickness. boulder_cluster, fish_school: length, width of
    the group, height of the highest, `count` members. anchor_scar: length, width, height = depth. point: echo
    without body or shadow, strength_db being its target strength. azimuth_deg: of the long axis. tilt_deg: its end
    towards the azimuth raised. burial_m: pushed into the floor. scour_m: depth of the moat around. above_m: height
    over the floor, for fish_school and point. strength_db: backscattering strength at normal incidence,
    specular_db: of the specular lobe on top of it.
    """

    kind: ObjectKind
    east_m: InPlane | None = None
    north_m: InPlane | None = None
    latitude_deg: Annotated[float, Meta(ge=-90.0, le=90.0)] | None = None
    longitude_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] | None = None
    leg: Annotated[int, Meta(ge=0)] | None = None
    along_m: float | None = None
    across_m: float | None = None
    azimuth_deg: Direction = 0.0
    tilt_deg: Tilt = 0.0
    burial_m: Length = 0.0
    scour_m: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    above_m: Length = 0.0
    length_m: Length | None = None
    width_m: Length | None = None
    height_m: Length | None = None
    top_m: Length | None = None
    count: Annotated[int, Meta(ge=1, le=1000)] | None = None
    strength_db: Decibel | None = None
    specular_db: Decibel | None = None
    is_target: bool | None = None


class Scatter(_Section, frozen=True, kw_only=True):
    """Scatter `count` objects of one kind at random on the floor that the planned legs sweep.

    They lie apart_m from each other and everything else.

    Ranges are [lowest, highest], drawn evenly; sizes by a power law with exponent -2.5 if `natural_sizes`.
    ground_range_m is of the leg that passes closest. Sizes left out are usual ones of the kind.
    """

    kind: ObjectKind
    count: Annotated[int, Meta(ge=1, le=5000)]
    ground_range_m: SizeRange | None = None
    apart_m: Annotated[float, Meta(ge=0.0, le=100.0)] = 6.0
    length_m: SizeRange | None = None
    width_m: SizeRange | None = None
    height_m: SizeRange | None = None
    burial_m: SizeRange = (0.0, 0.0)
    tilt_deg: tuple[Tilt, Tilt] = (0.0, 0.0)
    scour_m: SizeRange = (0.0, 0.0)
    strength_db: tuple[Decibel, Decibel] | None = None
    natural_sizes: bool = False
    is_target: bool | None = None


class TimeVariedGain(_Section, frozen=True, kw_only=True):
    """Set what the recorder compensates: spreading_db * log10(range) and absorption.

    Left out, absorption is the water's own; 30 dB and the water's own level out a floor that scatters alike at all
    angles.
    """

    spreading_db: Annotated[float, Meta(ge=0.0, le=60.0)] = 30.0
    absorption_db_per_km: Annotated[float, Meta(ge=0.0, le=2000.0)] | None = None


class SampleRecorder(_Section, frozen=True, kw_only=True):
    """Set how echoes become stored numbers.

    A flat floor of the scene's first type is stored as `seabed_counts` (root mean square) midway between its first
    return and range_m; for logarithms that is the count of its mean intensity. Above `full_scale` it clips.
    """

    samples: Literal["amplitude_uint8", "amplitude_uint16", "amplitude_float32", "log_uint8", "log_uint16"] = (
        "amplitude_uint16"
    )
    seabed_counts: Annotated[float, Meta(gt=0.0, le=1e6)] | None = None
    full_scale: Annotated[int, Meta(ge=15, le=65535)] | None = None
    db_per_count: Annotated[float, Meta(gt=0.0, le=3.0)] | None = None


class SyntheticAperture(_Section, frozen=True, kw_only=True):
    """Make image lines instead of pings: resolution and pixel do not depend on range.

    Shadows are blurred by the integration angle, wavelength over twice the along-track resolution, which
    `sub_apertures` parts of the spectrum share. `view`: which of them is recorded, `full` for all together. Of the
    sonar n_samples, ping_rate_hz, range_resolution_m, beam_width_deg, beam_lines and speckle_along_track_m do not count
    then.
    """

    along_track_resolution_m: Annotated[float, Meta(ge=0.005, le=1.0)] = 0.05
    range_resolution_m: Annotated[float, Meta(ge=0.005, le=1.0)] = 0.05
    pixels_per_resolution: Annotated[float, Meta(ge=1.0, le=4.0)] = 1.25
    sub_apertures: Annotated[int, Meta(ge=1, le=15)] = 5
    view: Annotated[int, Meta(ge=0, le=14)] | Literal["full"] = "full"


class Sonar(_Section, frozen=True, kw_only=True):
    """Describe the sonar and the water.

    Beam widths are two-way, at half power; `tilt_deg` is the depression of the vertical beam's axis.

    absorption_db_per_km: left out, from the frequency. noise_db: noise floor against the echo of a flat floor of the
    scene's first type midway between its first return and range_m. range_resolution_m: half power; its point-spread
    function correlates the speckle (0: independent samples). speckle_along_track_m: distance over which that of
    echoes stays correlated from ping to ping, 0 for none. looks: averaged per sample. beam_lines: rays that stand for
    the horizontal beam. ring_down_m: of the transmitter. *_db: level of the echo of the surface, of the other side, and
    of the bottom by way of the surface, against what the direct echo of the bottom is; left out: none.
    """

    frequency_khz: Frequency = 450.0
    range_m: MaxRange = 50.0
    n_samples: Samples = 1024
    ping_rate_hz: PingRate = 12.0
    sound_speed_mps: Annotated[float, Meta(ge=1400.0, le=1600.0)] = 1500.0
    beam_width_deg: BeamWidth = 0.4
    vertical_beam_width_deg: Annotated[float, Meta(ge=5.0, le=180.0)] = 50.0
    tilt_deg: Annotated[float, Meta(ge=0.0, le=90.0)] = 25.0
    absorption_db_per_km: Annotated[float, Meta(ge=0.0, le=2000.0)] | None = None
    noise_db: Annotated[float, Meta(ge=-100.0, le=40.0)] = -22.0
    range_resolution_m: RangeResolution = 0.06
    speckle_along_track_m: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.0
    looks: Annotated[int, Meta(ge=1, le=64)] = 1
    beam_lines: Annotated[int, Meta(ge=1, le=31)] = 5
    ring_down_m: Annotated[float, Meta(ge=0.0, le=20.0)] = 0.3
    surface_echo_db: Decibel | None = None
    crosstalk_db: Annotated[float, Meta(ge=-100.0, le=0.0)] | None = None
    second_bottom_db: Decibel | None = None
    gain: TimeVariedGain = TimeVariedGain()
    recorder: SampleRecorder = SampleRecorder()
    synthetic_aperture: SyntheticAperture | None = None


class Lawnmower(_Section, frozen=True, kw_only=True, tag_field="pattern", tag="lawnmower"):
    """Fly parallel legs to starboard of the first, there and back."""

    heading_deg: Direction = 0.0
    n_legs: Annotated[int, Meta(ge=1, le=200)] = 2
    leg_m: Annotated[float, Meta(gt=0.0, le=20_000.0)] = 150.0
    spacing_m: Annotated[float, Meta(gt=0.0, le=2000.0)] = 60.0
    start_east_m: InPlane = 0.0
    start_north_m: InPlane = 0.0


class Spiral(_Section, frozen=True, kw_only=True, tag_field="pattern", tag="spiral"):
    """Fly straight legs round a square, each pair `spacing_m` longer than the one before, turning to starboard."""

    heading_deg: Direction = 0.0
    n_legs: Annotated[int, Meta(ge=2, le=200)] = 8
    first_leg_m: Annotated[float, Meta(gt=0.0, le=5000.0)] = 60.0
    spacing_m: Annotated[float, Meta(gt=0.0, le=2000.0)] = 60.0
    start_east_m: InPlane = 0.0
    start_north_m: InPlane = 0.0


class Waypoints(_Section, frozen=True, kw_only=True, tag_field="pattern", tag="waypoints"):
    """Fly straight legs through points (east_m, north_m)."""

    points_m: Annotated[tuple[tuple[InPlane, InPlane], ...], Meta(min_length=2, max_length=1000)]


class Motion(_Section, frozen=True, kw_only=True):
    """Set the vehicle's true motion.

    Angles wander with the standard deviations given, over `attitude_period_s`. The current pushes it towards
    `current_towards_deg`, so it crabs. Altitude is held behind by `altitude_lag_s`, with an error that wanders by
    `altitude_sigma_m`.
    """

    roll_sigma_deg: Annotated[float, Meta(ge=0.0, le=20.0)] = 1.0
    pitch_sigma_deg: Annotated[float, Meta(ge=0.0, le=20.0)] = 0.7
    heading_sigma_deg: Annotated[float, Meta(ge=0.0, le=20.0)] = 0.4
    attitude_period_s: Annotated[float, Meta(ge=0.5, le=60.0)] = 4.0
    sway_sigma_m: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.1
    speed_sigma_percent: Annotated[float, Meta(ge=0.0, le=30.0)] = 3.0
    altitude_sigma_m: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.1
    altitude_lag_s: Annotated[float, Meta(ge=0.0, le=60.0)] = 3.0
    current_mps: Annotated[float, Meta(ge=0.0, le=3.0)] = 0.0
    current_towards_deg: Direction = 0.0
    pitch_offset_deg: Annotated[float, Meta(ge=-30.0, le=30.0)] = 0.0


STEADY: Final = Motion(
    roll_sigma_deg=0.0,
    pitch_sigma_deg=0.0,
    heading_sigma_deg=0.0,
    sway_sigma_m=0.0,
    speed_sigma_percent=0.0,
    altitude_sigma_m=0.0,
    altitude_lag_s=0.0,
)


class Track(_Section, frozen=True, kw_only=True):
    """Describe the plan and how it is flown, at speed_mps through the water.

    Without pings_in_turns the sonar is silent between legs.
    """

    plan: Lawnmower | Spiral | Waypoints
    speed_mps: Annotated[float, Meta(gt=0.1, le=10.0)] = 1.8
    altitude_m: Annotated[float, Meta(ge=0.5, le=200.0)] = 6.0
    turn_rate_deg_s: Annotated[float, Meta(gt=0.5, le=60.0)] = 8.0
    pings_in_turns: bool = True
    start_time_s: Annotated[float, Meta(ge=0.0, le=4e9)] = 1_700_000_000.0
    motion: Motion = Motion()


class NavigationError(_Section, frozen=True, kw_only=True):
    """Set the error of the reported navigation.

    Position: a slowly wandering error of `position_sigma_m` plus a drift of `drift_percent` of the way. Biases are
    drawn once per mission with the standard deviations given.
    """

    position_sigma_m: Annotated[float, Meta(ge=0.0, le=100.0)] = 0.4
    position_period_s: Annotated[float, Meta(ge=1.0, le=10_000.0)] = 120.0
    drift_percent: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.0
    heading_bias_sigma_deg: Annotated[float, Meta(ge=0.0, le=20.0)] = 0.3
    attitude_noise_deg: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.05
    altitude_bias_percent: Annotated[float, Meta(ge=0.0, le=50.0)] = 1.0
    altitude_noise_m: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.03
    speed_bias_percent: Annotated[float, Meta(ge=0.0, le=20.0)] = 0.3
    sound_speed_bias_mps: Annotated[float, Meta(ge=-50.0, le=50.0)] = 0.0


EXACT: Final = NavigationError(
    position_sigma_m=0.0,
    heading_bias_sigma_deg=0.0,
    attitude_noise_deg=0.0,
    altitude_bias_percent=0.0,
    altitude_noise_m=0.0,
    speed_bias_percent=0.0,
)


class Fault(_Section, frozen=True, kw_only=True):
    """Inject a fault for `n_pings` from ping `at_ping`.

    Every other ping is lost, that one first (drop), all are (gap), the gain changes by gain_db (gain_step), one side
    repeats its last samples (stuck_channel) or is missing (dead_channel), navigation stays away (navigation_loss),
    pulses of an echo sounder are heard, gain_db above the middle sample of their ping (interference).
    clock_step: clocks jump by step_s and stay there, whatever n_pings.
    """

    kind: Literal[
        "drop", "gap", "gain_step", "stuck_channel", "dead_channel", "clock_step", "navigation_loss", "interference"
    ]
    at_ping: Annotated[int, Meta(ge=0)]
    n_pings: Annotated[int, Meta(ge=1)] = 1
    side: Literal["port", "starboard", "both"] = "both"
    gain_db: Annotated[float, Meta(ge=-60.0, le=60.0)] = 0.0
    step_s: Annotated[float, Meta(ge=-86_400.0, le=86_400.0)] = 0.0


class Scene(_Section, frozen=True, kw_only=True):
    """Describe a simulated mission."""

    name: Annotated[str, Meta(max_length=100)] = ""
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)] = 1
    origin: Origin = Origin()
    world: World = World()
    objects: tuple[SceneObject, ...] = ()
    scatter: tuple[Scatter, ...] = ()
    sonar: Sonar = Sonar()
    track: Track
    navigation_error: NavigationError = NavigationError()
    faults: tuple[Fault, ...] = ()
