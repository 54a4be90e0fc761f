"""Render synthetic-aperture images: resolution does not depend on range, and shadows are as on the real floor.

A processor focuses every echo where it was closest to the reference track: a point at along-track x, across-track y and
height z lies in line x at slant range r = sqrt(y^2 + (H - z)^2), from wherever in the aperture it was heard. A
resolution of delta_x along the track takes an aperture that turns around the point by

    Theta = lambda / (2 delta_x)

(Hayes and Gough, IEEE J. Oceanic Eng. 34, 2009). Shadows are not focused: from each end of the aperture they fall in
another direction, so the image, which adds up all of it, blurs their edges over D Theta at a distance D behind the
object. A sub-aperture takes a part of the angles. Its shadows are sheared by its squint, tan theta, and sharper; its
resolution along the track is as many times coarser.

The mean image is the mean over rays that leave the track at angles theta spread over the aperture. Each is a vertical
slice through floor and bodies as in side-scan, and what it meets at y goes to line x_s + y tan theta, x_s being where
it started. Angles are of horizontal bearing. Approximations: y is worked out for the height of the floor below the
vehicle, so something z higher is off by tan theta H z / y, a centimetre or so; spreading and absorption are those at
closest approach, an error of second order in theta.

The speckled image is |h * (sqrt(E) w)|^2, E being the mean image, w white complex Gaussian noise and h the point-spread
function, a low pass along both axes. Every sub-aperture, being another part of the spectrum, has speckle of its own.

Echo energy from a resolution cell is summed over an aperture that grows with range against noise that does not depend
on it, so that the range law is that of a real beam: r^-3 and absorption. Lines follow one another at the resolution
over pixels_per_resolution, samples likewise. Of the sonar n_samples, ping_rate_hz, range_resolution_m, beam_width_deg,
beam_lines and speckle_along_track_m do not count.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from auv_mcm.records import Ping
from sim_replay.simulator import rays
from sim_replay.simulator.echo import vertical_pattern
from sim_replay.simulator.plan import Leg
from sim_replay.simulator.scene import SyntheticAperture
from sim_replay.simulator.sea import Sea
from sim_replay.simulator.speckle import band_limited_rows, low_pass_taps
from sim_replay.simulator.vehicle import MIN_ALTITUDE_M, MIN_DEPTH_M, SonarPose

View: TypeAlias = int | Literal["full"]
Floats: TypeAlias = NDArray[np.float64]
Float32s: TypeAlias = NDArray[np.float32]

WIDEST_RAD: Final = 0.5  # integration angle up to which small angles may be taken for their tangents

_SMOOTH_SHADOW_M: Final = 5.0  # a shadow this long blurs in steps of no more than the resolution
_BLOCK_LINES: Final = 256  # rendered at once; bounds memory
_STREAMS_PER_LEG: Final = 1 << 10  # 16 views with 64 looks each
_STREAMS_PER_VIEW: Final = 1 << 6  # room for the random numbers of one view
_STREAMS_PER_SIDE: Final = 1 << 32  # room for those of one side


class Strip(NamedTuple):
    """Locate the image of leg `number`, flown at depth_m. Line i lies `i * Aperture.line_m` from the leg's start."""

    leg: Leg
    number: int
    n_lines: int
    depth_m: float


class Aperture:
    """Render synthetic-aperture images of a sea.

    Lines depend on the scene, its seed, the leg and its number alone, not on how many are asked for at a time. Raises
    UsageError if the scene has no `sonar.synthetic_aperture` or one that takes angles beyond WIDEST_RAD.
    """

    def __init__(self, sea: Sea) -> None:
        sonar = sea.sonar
        aperture = sonar.synthetic_aperture
        if aperture is None:
            raise UsageError(
                "`sonar.synthetic_aperture` is missing: give it, `{}` for what is usual, or fly the scene ping by ping"
            )
        self.sea: Final = sea
        self.aperture: Final[SyntheticAperture] = aperture
        self.bin_m: Final = sonar.range_m / sonar.n_samples
        self.line_m: Final = aperture.along_track_resolution_m / aperture.pixels_per_resolution
        wavelength_m = sonar.sound_speed_mps / (1e3 * sonar.frequency_khz)
        self.integration_rad: Final = wavelength_m / (2.0 * aperture.along_track_resolution_m)
        if self.integration_rad > WIDEST_RAD:
            min_m = wavelength_m / (2.0 * WIDEST_RAD)
            raise UsageError(
                f"`sonar.synthetic_aperture.along_track_resolution_m` is {aperture.along_track_resolution_m:g}, which "
                f"at {sonar.frequency_khz:g} kHz takes an aperture of {math.degrees(self.integration_rad):.0f} "
                f"degrees; give {math.ceil(1e3 * min_m) / 1e3:g} or more"
            )
        n_views = aperture.sub_apertures
        n_rays = math.ceil(_SMOOTH_SHADOW_M * self.integration_rad / (aperture.along_track_resolution_m * n_views))
        n_angles = n_views * n_rays
        angles = ((np.arange(n_angles) + 0.5) / n_angles - 0.5) * self.integration_rad
        self._angles: Final = [part.tolist() for part in np.split(angles, n_views)]
        self._step_m = min(sea.world.cell_m, self.bin_m)
        self._n_nodes = math.ceil(sonar.range_m / self._step_m) + 2
        self._range_m = (np.arange(sonar.n_samples) + 0.5) * self.bin_m
        self._range_taps = low_pass_taps(aperture.range_resolution_m / self.bin_m)
        self._line_taps = {
            "full": low_pass_taps(aperture.pixels_per_resolution),
            "part": low_pass_taps(aperture.pixels_per_resolution * n_views),
        }

    def strip(self, leg: Leg, number: int) -> Strip:
        """Place the image of a leg, at the track's altitude above the mean floor along it.

        Raises UsageError where the floor leaves no room for a track at one depth.
        """
        track, world = self.sea.scene.track, self.sea.scene.world
        strip = Strip(leg, number, math.floor(leg.length_m / self.line_m + 1e-9) + 1, 0.0)
        floor = self._floor_m(strip, 0, strip.n_lines)
        depth = world.depth_m - float(floor.mean()) - track.altitude_m
        lowest_m = world.depth_m - depth - float(floor.max())
        if lowest_m < MIN_ALTITUDE_M or depth < MIN_DEPTH_M:
            raise UsageError(
                f"`track.plan`: on leg {number} a synthetic aperture at one depth would pass {lowest_m:.1f} m above "
                f"the floor and {depth:.1f} m below the surface; it needs {MIN_ALTITUDE_M:g} and {MIN_DEPTH_M:g}: give "
                "another `track.altitude_m`, a larger `world.depth_m` or a gentler slope"
            )
        return strip._replace(depth_m=depth)

    def poses(self, strip: Strip, start_s: float, first_line: int, n_lines: int) -> list[SonarPose]:
        """Return the poses abeam of each line, with the first line of the strip passed at `start_s`."""
        leg, speed = strip.leg, self.sea.scene.track.speed_mps
        poses = []
        for line in range(first_line, first_line + n_lines):
            east, north = leg.at(line * self.line_m, 0.0)
            poses.append(
                SonarPose(
                    time_s=start_s + line * self.line_m / speed,
                    east_m=east,
                    north_m=north,
                    depth_m=strip.depth_m,
                    heading_rad=leg.direction_rad,
                    pitch_rad=0.0,
                    roll_rad=0.0,
                    course_rad=leg.direction_rad,
                    speed_mps=speed,
                    on_leg=strip.number,
                )
            )
        return poses

    def lines(self, strip: Strip, start_s: float, first_number: int) -> Iterator[tuple[SonarPose, Ping]]:
        """Yield all lines of the recorded view, numbered from `first_number`, with the poses they are given at.

        No ping carries an altitude.
        """
        for first in range(0, strip.n_lines, _BLOCK_LINES):
            n_lines = min(_BLOCK_LINES, strip.n_lines - first)
            poses = self.poses(strip, start_s, first, n_lines)
            intensity = self.intensity(strip, first, n_lines, self.aperture.view)
            yield from zip(poses, self.sea.record(intensity, poses, first_number + first), strict=True)

    def intensity(self, strip: Strip, first_line: int, n_lines: int, view: View) -> Float32s:
        """Return the speckled image with noise, (n_lines, 2, n_samples) float32, port first.

        It is in units of `reference`. view: of the sub-apertures, which count from aft to ahead.
        """
        sonar, seed = self.sea.sonar, self.sea.scene.seed
        line_taps, range_taps = self._line_taps["full" if view == "full" else "part"], self._range_taps
        around, beside = line_taps.size // 2, range_taps.size // 2
        mean = self.mean_intensity(strip, first_line - around, n_lines + 2 * around, view)
        amplitude = np.sqrt((mean + self.sea.noise) * (1.0 / self.sea.reference)).astype(np.float32)
        amplitude = np.pad(amplitude, ((0, 0), (0, 0), (beside, beside)), mode="edge")
        first_stream = strip.number * _STREAMS_PER_LEG + (0 if view == "full" else view + 1) * _STREAMS_PER_VIEW
        image = np.zeros((n_lines, 2, sonar.n_samples), dtype=np.float32)
        for side in range(2):
            for stream in range(first_stream, first_stream + sonar.looks):
                field = band_limited_rows(
                    seed,
                    side * _STREAMS_PER_SIDE + stream,
                    first_line,
                    n_lines,
                    sonar.n_samples,
                    line_taps,
                    range_taps,
                    amplitude[:, side],
                )
                image[:, side] += field.real**2 + field.imag**2
        image *= np.float32(1.0 / sonar.looks)
        return image

    def mean_intensity(self, strip: Strip, first_line: int, n_lines: int, view: View) -> Floats:
        """Return the mean image before the point-spread function, without noise.

        It is (n_lines, 2, n_samples), in the sea's units.
        """
        angles = [angle for part in self._angles for angle in part] if view == "full" else self._angles[view]
        floor = self._floor_m(strip, first_line, n_lines)
        altitude = self.sea.scene.world.depth_m - strip.depth_m - floor
        across_m = np.sqrt(np.maximum(self._range_m**2 - altitude[:, None] ** 2, 0.0))
        image = np.zeros((n_lines, 2, self.sea.sonar.n_samples))
        for angle in angles:
            image += self._seen(strip, first_line, across_m * (math.tan(angle) / self.line_m), angle)
        image *= self.sea.spreading / len(angles)
        self._add_points(image, strip, first_line)
        self.sea.add_other_paths(image, self.poses(strip, 0.0, first_line, n_lines), floor)
        return image

    def _seen(self, strip: Strip, first_line: int, ahead: Floats, angle_rad: float) -> Floats:
        """Compute the energy per metre of track that rays of one bearing bring back, moved to the lines it belongs to,
        (n_lines, 2, n_samples).

        ahead: (n_lines, n_samples) lines by which a ray that meets this line at this range started before it.
        """
        n_lines, n_samples = ahead.shape
        whole = np.floor(ahead).astype(np.int64)
        part = (ahead - whole)[:, None, :]
        first = first_line - int(whole.max()) - 1
        stop = first_line + n_lines - int(whole.min())
        fan = self._fan(strip, np.arange(first, stop), angle_rad)
        rendered = self.sea.energy(fan, 2 * (stop - first), self.bin_m / math.cos(angle_rad))
        rendered = rendered.reshape(stop - first, 2, n_samples)
        source = (np.arange(n_lines)[:, None] + (first_line - first) - whole)[:, None, :]
        nearer = np.take_along_axis(rendered, source, axis=0)
        farther = np.take_along_axis(rendered, source - 1, axis=0)
        return np.asarray(nearer * (1.0 - part) + farther * part)

    def _fan(self, strip: Strip, line: NDArray[np.int64], angle_rad: float) -> rays.Fan:
        """Cast rays of both sides from lines, rows 2 i for port and 2 i + 1 for starboard of the i-th.

        Nodes lie at the same across-track distances whatever the angle.

        Slant depth is depth over the cosine of the angle, which makes the ray's slant range that of closest approach
        over the cosine.
        """
        leg, cosine = strip.leg, math.cos(angle_rad)
        along = line * self.line_m
        sine_ahead, cosine_ahead = math.sin(leg.direction_rad), math.cos(leg.direction_rad)
        step = self._step_m / cosine
        turned = [leg.direction_rad + side * (0.5 * math.pi - angle_rad) for side in (-1.0, 1.0)]
        n = 2 * len(line)
        return rays.Fan(
            east_m=np.repeat(leg.east_m + along * sine_ahead, 2),
            north_m=np.repeat(leg.north_m + along * cosine_ahead, 2),
            step_east_m=np.tile([step * math.sin(bearing) for bearing in turned], len(line)),
            step_north_m=np.tile([step * math.cos(bearing) for bearing in turned], len(line)),
            elevation_m=np.full(n, self.sea.scene.world.depth_m - strip.depth_m),
            slant_factor=np.full(n, 1.0 / cosine),
            axis_rad=np.full(n, math.radians(self.sea.sonar.tilt_deg)),
            weight=np.full(n, cosine),  # rays from a metre of track are so far apart
            ping=np.arange(n, dtype=np.int64),
            n_nodes=self._n_nodes,
        )

    def _floor_m(self, strip: Strip, first_line: int, n_lines: int) -> Floats:
        """Return the height of the bare floor below lines, (n_lines,)."""
        places = [strip.leg.at(line * self.line_m, 0.0) for line in range(first_line, first_line + n_lines)]
        return self.sea.world.elevation_m(*np.array(places).T)

    def _add_points(self, image: Floats, strip: Strip, first_line: int) -> None:
        """Add echoes of points, focused like everything else; points neither cast nor lie in shadows."""
        sonar = self.sea.sonar
        axis = math.radians(sonar.tilt_deg)
        for east, north, height, strength in self.sea.points.tolist():
            along, across = strip.leg.along_across(east, north)
            below = self.sea.scene.world.depth_m - strip.depth_m - height
            slant = math.hypot(across, below)
            line, column = along / self.line_m, slant / self.bin_m - 0.5
            if not (first_line - 1 < line < first_line + len(image) and -1.0 < column < sonar.n_samples):
                continue
            off = (below * math.cos(axis) - abs(across) * math.sin(axis)) / slant
            echo = strength * float(vertical_pattern(np.asarray(off), sonar.vertical_beam_width_deg)) / self.line_m
            for at_line, line_share in _split(line):
                for at_column, column_share in _split(column):
                    row = at_line - first_line
                    if 0 <= row < len(image) and 0 <= at_column < sonar.n_samples:
                        image[row, int(across > 0.0), at_column] += (
                            echo * line_share * column_share * self.sea.spreading[at_column]
                        )


def _split(place: float) -> Sequence[tuple[int, float]]:
    """Return the whole numbers on both sides of a place, and their shares."""
    low = math.floor(place)
    return (low, low + 1 - place), (low + 1, place - low)
