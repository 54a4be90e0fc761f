"""Render a scene as a side-scan sonar images it: Lambert's law under a beam pattern, with cast shadows.

    I = Phi(depression) * R * cos(incidence),   0 in shadow

Coiras, Petillot and Lane, "Multiresolution 3-D reconstruction from side-scan sonar images", IEEE Trans. Image
Processing 16(2), 2007. A scene is one side of a line on pings by ground-range columns, column j around (j + 0.5) *
column_spacing_m. Heights are above the flat bottom that lies `altitude_m` below the sonar. The facet of a pixel spans
from the column before to it, so that a wall lights the pixel where it stands.
"""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray


class BeamPattern(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Return the level of the echo over the depression of the line of sight, with all constants of the sonar in it.

    depression_rad: (n,) float64, below the horizontal, increasing. gain: (n,) float64, linear intensity. Between angles
    the gain is interpolated, beyond them it stays.
    """

    depression_rad: NDArray[np.float64]
    gain: NDArray[np.float64]


class SeafloorScene(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold one side of a line as the forward model has it.

    elevation_m: (n_pings, n_columns) float64, above the flat bottom. reflectivity: the same shape, relative to the
    beam's gain. altitude_m: (n_pings,) float64, of the sonar above the flat bottom. along_m: (n_pings,) float64, places
    of the pings along the track, increasing. valid: (n_pings, n_columns) bool, False where nothing was recorded. Raises
    ValueError where shapes disagree.
    """

    elevation_m: NDArray[np.float64]
    reflectivity: NDArray[np.float64]
    beam: BeamPattern
    altitude_m: NDArray[np.float64]
    along_m: NDArray[np.float64]
    column_spacing_m: float
    valid: NDArray[np.bool_]

    def __post_init__(self) -> None:
        shape, n_pings = self.elevation_m.shape, self.elevation_m.shape[:1]
        if (
            self.reflectivity.shape != shape
            or self.valid.shape != shape
            or self.altitude_m.shape != n_pings
            or self.along_m.shape != n_pings
        ):
            raise ValueError(
                f"scene of {shape} pings and columns: reflectivity {self.reflectivity.shape}, valid "
                f"{self.valid.shape}, altitude_m {self.altitude_m.shape} and along_m {self.along_m.shape} do not fit"
            )


class Rendering(NamedTuple):
    """Hold intensity: (n_pings, n_columns) float64, without speckle or noise, 0 in shadow.

    shadow: the same shape, bool.
    """

    intensity: NDArray[np.float64]
    shadow: NDArray[np.bool_]


def render_image(scene: SeafloorScene) -> Rendering:
    """Render the noise-free image of a scene and its cast shadows."""
    shadow = cast_shadow(scene.elevation_m, scene.altitude_m, scene.column_spacing_m)
    intensity = beam_gain(scene.beam, scene.elevation_m, scene.altitude_m, scene.column_spacing_m)
    intensity *= scene.reflectivity
    intensity *= cos_incidence(scene.elevation_m, scene.altitude_m, scene.along_m, scene.column_spacing_m)
    intensity[shadow] = 0.0
    return Rendering(intensity, shadow)


def ground_range_m(n_columns: int, column_spacing_m: float) -> NDArray[np.float64]:
    """Return the ground range of the column centres, (n_columns,) float64."""
    return np.asarray((np.arange(n_columns) + 0.5) * column_spacing_m)


def depression_rad(
    elevation_m: NDArray[np.float64], altitude_m: NDArray[np.float64], column_spacing_m: float
) -> NDArray[np.float64]:
    """Return the angle below the horizontal of the line of sight to each pixel, (n_pings, n_columns) float64."""
    return np.arctan2(altitude_m[:, None] - elevation_m, ground_range_m(elevation_m.shape[1], column_spacing_m))


def beam_gain(
    beam: BeamPattern, elevation_m: NDArray[np.float64], altitude_m: NDArray[np.float64], column_spacing_m: float
) -> NDArray[np.float64]:
    """Project the beam pattern on the relief, (n_pings, n_columns) float64."""
    return np.interp(depression_rad(elevation_m, altitude_m, column_spacing_m), beam.depression_rad, beam.gain)


def across_slope(elevation_m: NDArray[np.float64], column_spacing_m: float) -> NDArray[np.float64]:
    """Rise per metre away from the sonar over the facet that ends at each column.

    The first column has the slope of the second.
    """
    slope = np.empty_like(elevation_m)
    if elevation_m.shape[1] < 2:
        slope[:] = 0.0
        return slope
    np.subtract(elevation_m[:, 1:], elevation_m[:, :-1], out=slope[:, 1:])
    slope[:, 1:] *= 1.0 / column_spacing_m
    slope[:, 0] = slope[:, 1]
    return slope


def along_slope(elevation_m: NDArray[np.float64], along_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rise per metre along the track between the neighbours of each ping, one-sided at both ends."""
    slope = np.zeros_like(elevation_m)
    if len(along_m) < 2:
        return slope
    slope[1:-1] = (elevation_m[2:] - elevation_m[:-2]) / (along_m[2:] - along_m[:-2])[:, None]
    slope[0] = (elevation_m[1] - elevation_m[0]) / (along_m[1] - along_m[0])
    slope[-1] = (elevation_m[-1] - elevation_m[-2]) / (along_m[-1] - along_m[-2])
    return slope


def cos_incidence(
    elevation_m: NDArray[np.float64],
    altitude_m: NDArray[np.float64],
    along_m: NDArray[np.float64],
    column_spacing_m: float,
) -> NDArray[np.float64]:
    """Compute the cosine between the line of sight and each facet's normal (-dZ/dy, -dZ/dx, 1).

    It is 0 for facets turned away.
    """
    across, along = across_slope(elevation_m, column_spacing_m), along_slope(elevation_m, along_m)
    ground_m, depth_m = ground_range_m(elevation_m.shape[1], column_spacing_m), altitude_m[:, None] - elevation_m
    facing = np.maximum(depth_m + ground_m * across, 0.0)
    return np.asarray(facing / np.sqrt((ground_m**2 + depth_m**2) * (1.0 + across**2 + along**2)))


def cast_shadow(
    elevation_m: NDArray[np.float64], altitude_m: NDArray[np.float64], column_spacing_m: float
) -> NDArray[np.bool_]:
    """Mask pixels where a nearer pixel of the same ping rises above the line of sight, (n_pings, n_columns) bool.

    O(n) by a running maximum.
    """
    tangent = (elevation_m - altitude_m[:, None]) / ground_range_m(elevation_m.shape[1], column_spacing_m)
    return np.asarray(tangent < np.maximum.accumulate(tangent, axis=1))
