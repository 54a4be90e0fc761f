"""Embed targets into a recorded log: recover the floor around each place, put the target on it, render what changes.

Coiras, Mignotte, Petillot, Bell and Lebart, "Supervised target detection and classification by training on augmented
reality data", IET Radar, Sonar & Navigation 1(1), 2007. Outside of highlight and shadow the recorded echo is scaled by
the ratio of the renders with and without the target, so that its speckle, artefacts and gain stay. Every pass that sees
the place gets the target.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from auv_mcm.errors import BadInputError
from auv_mcm.records import EchoTrace, Side
from auv_mcm.safe_files import read_regular
from auv_mcm.settings.config import Config
from auv_mcm.waterfall.ground import ground_edges_m, make_traces, mean_between
from auv_mcm.waterfall.transfer import to_intensity
from sim_replay.augment.background_log import SamplePlace, Stretch, Survey, overwrite, sample_places, to_samples
from sim_replay.augment.embed_render import REFERENCE_NORTH_M, Echoes, PingWindow, Relief, echoes
from sim_replay.augment.floor import Floor, recover_floor
from sim_replay.augment.line import Change, SampleScatter, measure_line, mixed, spread_over_taps
from sim_replay.augment.shadows import ShadowRuns, shadow_runs
from sim_replay.augment.targets import Placement
from sim_replay.augment.track import SIGN, PingTrack, heard_at
from sim_replay.simulator.objects import PlacedObject

_MAX_LOG_BYTES: Final = 1 << 30  # of a survey, held in memory: chosen
_COLUMN_M: Final = 0.1  # of the image that the floor is recovered from, which shows no relief finer than that
_AROUND_M: Final = 3.0  # of sea floor recovered before and after an object
_BEFORE_M: Final = 8.0  # and towards the sonar, whence it may be hidden
_BEYOND_M: Final = 2.0  # and behind the shadow's end
_LEVEL_M: Final = 4.0  # m of range that the level is averaged over
_GLINT: Final = 6.0  # times the level, above which a recorded echo counts as that bright
_MIN_FACING: Final = 0.2  # of a flat floor's: what is seen to echo cannot face away more
_SAME_PASS_M: Final = 5.0  # m along the track, minimum, between two passes on one stretch

Floats: TypeAlias = NDArray[np.float64]
Bools: TypeAlias = NDArray[np.bool_]


class EmbeddedPicture(NamedTuple):
    """Hold one side of a window over ground range, as recover_floor takes it.

    intensity: (n_pings, n_columns) float64, linear, 0 where not valid. valid: the same shape, bool. shadow: where it
    lies in shadow. altitude_m, along_m: (n_pings,) float64. Column j is around (j + 0.5) * column_spacing_m.
    """

    intensity: Floats
    valid: Bools
    shadow: ShadowRuns
    altitude_m: Floats
    along_m: Floats
    column_spacing_m: float


class EmbeddedView(NamedTuple):
    """Describe what one pass shows of an embedded object.

    visible_fraction: of its echo, 0 to 1; contrast_db: its highlight over the floor's level, NaN if nothing of either
    is heard. n_samples: that were changed.
    """

    ping: int
    side: Side
    ground_range_m: float
    time_s: float
    visible_fraction: float
    contrast_db: float
    n_samples: int


class Embedded(NamedTuple):
    """Describe one object in the log; looks: by pass, the one it was placed by first."""

    scene_object: PlacedObject
    latitude_deg: float
    longitude_deg: float
    looks: tuple[EmbeddedView, ...]


class Augmented(NamedTuple):
    """Hold the log with targets in it, the same bytes elsewhere."""

    data: bytes
    objects: tuple[Embedded, ...]


def embed(
    survey: Survey,
    track: PingTrack,
    placements: Sequence[Placement],
    config: Config,
    seed: int,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Augmented:
    """Embed every object in the log of `survey`, one after the other, so that later ones stand in earlier shadows.

    Equal logs, placements and seeds give equal bytes. Raises BadInputError where samples cannot
    be overwritten.
    """
    data = bytearray(read_regular(survey.path, _MAX_LOG_BYTES))
    places = sample_places(survey.path, [ping for stretch in survey.stretches for ping in stretch.pings])
    lines: dict[tuple[int, Side], SampleScatter] = {}
    done: list[Embedded] = []
    for number, placement in enumerate(placements):
        looks: list[EmbeddedView] = []
        for pass_number, (ping, side, ground_range_m, ahead_m) in enumerate(passes_over_object(track, placement)):
            stretch_number, index = int(track.stretch[ping]), int(track.row[ping])
            stretch = survey.stretches[stretch_number]
            if (stretch_number, side) not in lines:
                lines[stretch_number, side] = measure_line(
                    stretch, side, survey.transfer, config.sonar.blank_m, survey.absorption_per_m
                )
            heading_rad = float(track.heading_rad[ping])
            line = lines[stretch_number, side]
            window = _Window(data, places, stretch, index, heading_rad, side, ground_range_m, ahead_m, line)
            looks.append(_embed_look(window, survey, placement.scene_object, config, seed, 64 * number + pass_number))
            looks[-1] = looks[-1]._replace(ping=int(track.number[ping]))
        latitude, longitude = located(survey, track, placement, config)
        done.append(Embedded(placement.scene_object, latitude, longitude, tuple(looks)))
        progress((number + 1) / len(placements))
    return Augmented(bytes(data), tuple(done))


def passes_over_object(track: PingTrack, placement: Placement) -> list[tuple[int, Side, float, float]]:
    """List every pass that sees an object, the one it was placed by first.

    Each with ping, side, ground range and distance ahead of that ping.
    """
    own = [(placement.ping, placement.side, placement.ground_range_m, 0.0)]
    for ping, side, ground_range_m in track.looks(placement.scene_object.east_m, placement.scene_object.north_m):
        along_m, stretch = track.along_m[ping], track.stretch[ping]
        near = max(_SAME_PASS_M, 0.5 * ground_range_m)
        if any(track.stretch[one[0]] == stretch and abs(track.along_m[one[0]] - along_m) < near for one in own):
            continue
        sine, cosine = math.sin(track.heading_rad[ping]), math.cos(track.heading_rad[ping])
        east_m, north_m = (
            placement.scene_object.east_m - track.east_m[ping],
            placement.scene_object.north_m - track.north_m[ping],
        )
        own.append((ping, side, ground_range_m, float(east_m * sine + north_m * cosine)))
    return own


class _Window(NamedTuple):
    """Hold a place in one pass. ping: the one that looks at it, by its place in the stretch; heading_rad: of the array
    then. data: the log as far as targets are in it.
    """

    data: bytearray
    places: dict[tuple[int, Side], SamplePlace]
    stretch: Stretch
    ping: int
    heading_rad: float
    side: Side
    ground_range_m: float
    ahead_m: float
    line: SampleScatter

    def samples(self, pings: slice) -> NDArray[Any]:
        """Return (n_pings, n_samples) stored numbers, near to far. Raises BadInputError where the file does not hold
        them as they are read.
        """
        rows = []
        for k in range(pings.start, pings.stop):
            trace, place = self.stretch.trace(k, self.side), self.places.get((self.stretch.pings[k].number, self.side))
            if trace is None or place is None:
                raise BadInputError(
                    f"{self.stretch.pings[k].place}: its {self.side} samples cannot be overwritten, as the log does "
                    "not store them as they are read: scaled, signed, or both sides in one. Keep targets away from "
                    "there, or export the log with unsigned samples and a channel for each side"
                )
            stored = np.frombuffer(self.data, trace.samples.dtype, trace.samples.shape[0], place.offset)
            rows.append(stored[::-1] if place.turned else stored)
        return np.stack(rows)


def _embed_look(
    window: _Window, survey: Survey, scene_object: PlacedObject, config: Config, seed: int, stream: int
) -> EmbeddedView:
    stretch, side, line, ground_m = window.stretch, window.side, window.line, window.ground_range_m
    trace = stretch.trace(window.ping, side)
    assert trace is not None
    height_m, along = float(stretch.first_return_m[window.ping]), stretch.along_m - stretch.along_m[window.ping]
    pings, reach_m, farthest_m = _extent(window, scene_object, config, trace)
    samples = window.samples(pings)
    recorded, valid = to_intensity(samples, survey.transfer)
    intensity = np.where(valid, recorded, 0.0).astype(np.float64)

    picture = _picture(intensity, valid, stretch, pings, window, trace.first_range_m, trace.spacing_m, farthest_m)
    scene = recover_floor(
        picture.intensity, picture.valid, picture.altitude_m, picture.along_m, picture.column_spacing_m
    )
    first = max(0, math.floor((ground_m - reach_m - _BEFORE_M) / picture.column_spacing_m))
    stands_on, hides = reliefs(scene, picture, along[pings], first)
    view = PingWindow(
        side=side,
        along_m=along[pings],
        turn_rad=stretch.poses.heading_rad[pings] - stretch.poses.heading_rad[window.ping],
        height_m=stretch.first_return_m[pings],
        first_edge_m=trace.first_range_m - 0.5 * trace.spacing_m,
        spacing_m=trace.spacing_m,
        n_samples=trace.samples.shape[0],
        beam_width_deg=0.0 if config.sonar.kind == "sas" else config.sonar.used_beam_width_deg,
        beam=scene.beam,
    )
    placed = scene_object._replace(
        east_m=SIGN[side] * ground_m,
        north_m=REFERENCE_NORTH_M + window.ahead_m,
        azimuth_rad=scene_object.azimuth_rad - window.heading_rad,
        strength_db=scene_object.strength_db
        + 10.0 * math.log10(_floor_strength(stands_on, ground_m, window.ahead_m, height_m)),
    )
    heard = echoes(view, hides, placed, stands_on, farthest_m)
    changed_intensity, changed, contrast_db = _heard_anew(intensity, heard, line, trace.spacing_m, seed, stream)
    changed &= valid
    full_scale = survey.full_scale[side]
    for row, k in enumerate(range(pings.start, pings.stop)):
        if changed[row].any():
            new = to_samples(changed_intensity[row], survey.transfer, full_scale, samples.dtype)
            overwrite(window.data, window.places[stretch.pings[k].number, side], new, changed[row])
    whole = float(heard.in_full_view.sum())
    return EmbeddedView(
        ping=window.ping,
        side=side,
        ground_range_m=ground_m,
        time_s=stretch.pings[window.ping].time_s,
        visible_fraction=min(1.0, float(heard.target.sum()) / whole) if whole > 0.0 else 0.0,
        contrast_db=contrast_db,
        n_samples=int(np.count_nonzero(changed)),
    )


def _extent(
    window: _Window, scene_object: PlacedObject, config: Config, trace: EchoTrace
) -> tuple[slice, float, float]:
    """Find the pings that see the object or its shadow, its reach, m, and the farthest ground range of both, m."""
    stretch, ground_m = window.stretch, window.ground_range_m
    height_m = float(stretch.first_return_m[window.ping])
    top_m = min(scene_object.height_m + scene_object.length_m * abs(math.sin(scene_object.tilt_rad)), 0.9 * height_m)
    # The recovered floor may fall away behind the object: half as long again as on a plane.
    reach_m = scene_object.reach_m * (1.0 + 0.6 * (scene_object.scour_m > 0.0))
    shadow_m = 1.5 * ((ground_m + reach_m) * height_m / (height_m - top_m) - ground_m)
    farthest_m = ground_m + shadow_m + _BEYOND_M
    around_m = reach_m + config.sonar.beam_width_rad * min(farthest_m, config.sonar.max_range_m) + _AROUND_M
    along = stretch.along_m - stretch.along_m[window.ping]
    pings = slice(int(np.searchsorted(along, -around_m)), int(np.searchsorted(along, around_m, side="right")))
    # As far as every ping of the window reaches.
    last_m = trace.first_range_m + (trace.samples.shape[0] - 0.5) * trace.spacing_m
    farthest_m = min(farthest_m, math.sqrt(max(last_m**2 - float(stretch.first_return_m[pings].max()) ** 2, 0.0)))
    return pings, reach_m, farthest_m


def _picture(
    intensity: Floats,
    valid: Bools,
    stretch: Stretch,
    pings: slice,
    window: _Window,
    first_range_m: float,
    spacing_m: float,
    farthest_m: float,
) -> EmbeddedPicture:
    n_columns = max(8, math.floor(farthest_m / _COLUMN_M))
    traces = make_traces(
        intensity.astype(np.float32), valid, np.zeros(valid.shape, dtype=np.bool_), first_range_m, spacing_m
    )
    edges = ground_edges_m(stretch.first_return_m[pings], n_columns, _COLUMN_M)
    ground = mean_between(traces, edges)
    sample = np.clip(
        (0.5 * (edges[:, 1:] + edges[:, :-1]) - first_range_m) / spacing_m, 0, window.line.noise.size - 1
    ).astype(np.intp)
    along_m = stretch.along_m[pings]
    row_m = max(float(along_m[-1] - along_m[0]) / max(len(along_m) - 1, 1), 1e-3)
    shadow = shadow_runs(ground.intensity, window.line.noise[sample], row_m, _COLUMN_M)
    return EmbeddedPicture(ground.intensity, ground.valid, shadow, stretch.first_return_m[pings], along_m, _COLUMN_M)


def reliefs(scene: Floor, picture: EmbeddedPicture, along_m: Floats, first_column: int) -> tuple[Relief, Relief]:
    """Return the floor that an object stands on, and the floor that hides and echoes.

    The second rises where recorded shadows begin, as high as their length asks for, and nowhere faces away from the
    sonar where it is seen to echo: an image resolves slopes only within its speckle.
    """
    columns = slice(first_column, None)
    elevation = scene.elevation_m[:, columns].copy()
    reflectivity = np.maximum(scene.reflectivity[:, columns], 0.0)
    shadow = picture.shadow.mask(scene.elevation_m.shape)[:, columns]
    spacing_m = picture.column_spacing_m
    ground_m = (first_column + np.arange(elevation.shape[1]) + 0.5) * spacing_m
    height_m = picture.altitude_m[:, None]
    stands_on = Relief(elevation.copy(), reflectivity, along_m, first_column, spacing_m)
    echoing = reflectivity.copy()
    runs = picture.shadow
    inside = runs.stop > first_column
    row, start, stop = (
        runs.row[inside],
        np.maximum(runs.start[inside] - first_column, 0),
        runs.stop[inside] - first_column,
    )
    crest_m = picture.altitude_m[row] * (1.0 - ground_m[start] / (ground_m[stop - 1] + 0.5 * spacing_m))
    elevation[row, start] = np.maximum(elevation[row, start], crest_m)
    echoing[row, start] = 0.0
    level_slope = -height_m / ground_m
    gain = (elevation - height_m) / ground_m - _MIN_FACING * level_slope
    seen = height_m + ground_m * (np.maximum.accumulate(gain, axis=1) + _MIN_FACING * level_slope)
    elevation = np.where(shadow, elevation, np.maximum(elevation, seen))
    return stands_on, Relief(elevation, echoing, along_m, first_column, spacing_m)


def _floor_strength(relief: Relief, ground_m: float, ahead_m: float, height_m: float) -> float:
    """Return the echo of the floor around a place: cosine of incidence times reflectivity."""
    rows = np.abs(relief.along_m - ahead_m) < _AROUND_M
    column = int(ground_m / relief.column_spacing_m) - relief.first_column
    half = max(1, round(_AROUND_M / relief.column_spacing_m))
    around = relief.reflectivity[rows, max(column - half, 0) : column + half + 1]
    return float(height_m / math.hypot(ground_m, height_m) * max(float(around.mean()) if around.size else 1.0, 1e-3))


def _heard_anew(
    recorded: Floats, heard: Echoes, line: SampleScatter, spacing_m: float, seed: int, stream: int
) -> tuple[Floats, Bools, float]:
    """Return the intensity with the object, its changed part, and the highlight's contrast."""
    bare, floor = spread_over_taps(heard.bare, line.range_taps), spread_over_taps(heard.floor, line.range_taps)
    # Where nothing echoed before, nothing can be lost: a real shadow stays as it is.
    little = 1e-2 * uniform_filter1d(bare.mean(axis=0), max(3, round(_LEVEL_M / spacing_m)), mode="nearest")
    kept = np.divide(floor, bare, out=np.ones_like(bare), where=(bare > little) & (floor != bare))
    level = _level(recorded, heard.bare, line, spacing_m)
    added = heard.target * level
    touched = np.flatnonzero((kept != 1.0).any(axis=0) | (added > 0.0).any(axis=0))
    if not touched.size:
        return recorded, np.zeros(recorded.shape, dtype=np.bool_), math.nan
    half = line.range_taps.size // 2
    columns = slice(max(0, int(touched[0]) - half), min(recorded.shape[1], int(touched[-1]) + half + 1))
    change = Change(kept[:, columns], added[:, columns])
    new, changed = recorded.copy(), np.zeros(recorded.shape, dtype=np.bool_)
    new[:, columns], changed[:, columns] = mixed(recorded[:, columns], change, line, line.noise[columns], seed, stream)
    highlight = spread_over_taps(added, line.range_taps)
    if not highlight.any():
        return new, changed, math.nan
    bright = highlight > 0.5 * highlight.max()
    there, around = (
        float(new[bright].mean()),
        float(np.broadcast_to(level * heard.bare.mean(axis=0), recorded.shape)[bright].mean()),
    )
    return new, changed, 10.0 * (math.log10(there) - math.log10(around)) if there > 0.0 and around > 0.0 else math.nan


def _level(recorded: Floats, bare: Floats, line: SampleScatter, spacing_m: float) -> Floats:
    """Estimate the recorded intensity of the floor per rendered, (n_samples,), over a few metres, without shadows,
    glints and noise.
    """
    lit = (bare > 0.0).astype(np.float64)
    width = max(3, round(_LEVEL_M / spacing_m))

    def along_range(values: Floats) -> Floats:
        return np.asarray(uniform_filter1d(values.sum(axis=0), width, mode="nearest"))

    typical = along_range(recorded * lit) / np.maximum(along_range(lit), 1e-9)
    clipped = np.minimum(recorded, _GLINT * typical) * lit
    echo = np.maximum(along_range(clipped) - line.noise * along_range(lit), 0.05 * along_range(clipped))
    return np.asarray(echo / np.maximum(along_range(bare), 1e-30))


def located(survey: Survey, track: PingTrack, placement: Placement, config: Config) -> tuple[float, float]:
    """Return latitude and longitude of a place abeam of a ping."""
    stretch, index = survey.stretches[int(track.stretch[placement.ping])], int(track.row[placement.ping])
    pings = slice(index, index + 1)
    latitude, longitude, _ = heard_at(stretch, pings, placement.side, placement.ground_range_m, config.sonar)
    return float(latitude[0]), float(longitude[0])
