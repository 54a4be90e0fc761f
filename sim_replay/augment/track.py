"""Locate the footprints of a log's pings: which places they show well, and which pings look straight at a place."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.geometry.geodesy import LocalFrame
from auv_mcm.geometry.georeference import EchoGeometry, aspect_deg, locate
from auv_mcm.geometry.pose_track import slice_pose
from auv_mcm.records import SIDES, Side
from auv_mcm.settings.config import Config, SonarConfig
from sim_replay.augment.background_log import Stretch, Survey

_MARGIN_PINGS: Final = 8  # of sea floor that must have been recorded before and after an object
_MARGIN_M: Final = 1.5  # the same across the track
_ABEAM_M: Final = 20.0  # m: ground range of the places to either side that show where abeam is
_MIN_SPEED_MPS: Final = 0.2  # m/s: keeps the turn per metre finite

Floats: TypeAlias = NDArray[np.float64]

SIGN: Final[dict[Side, float]] = {"port": -1.0, "starboard": 1.0}


class PingTrack(NamedTuple):
    """Hold all pings of a log; arrays are (n_pings,), float64 unless named otherwise.

    number: int64, in the log. stretch, row: int64, the stretch of the survey and the ping's place in it. east_m,
    north_m: in the plane of `frame`, of the floor below the array. heading_rad: of the array. nearest_m, farthest_m:
    (2, n_pings), port first: ground ranges that a side shows well, NaN where it shows none. why: what is wrong with a
    whole ping, "" if nothing. yaw_per_m, pitch_stretch: by how much the spacing of pings on the bottom grows with each
    metre of range to port, and by pitching.
    """

    frame: LocalFrame
    number: NDArray[np.int64]
    stretch: NDArray[np.int64]
    row: NDArray[np.int64]
    along_m: Floats
    east_m: Floats
    north_m: Floats
    heading_rad: Floats
    first_return_m: Floats
    nearest_m: Floats
    farthest_m: Floats
    why: tuple[str, ...]
    yaw_per_m: Floats
    pitch_stretch: Floats
    max_spacing_ratio: float

    def refusal(self, ping: int, side: Side, ground_range_m: float) -> str:
        """Return the reason why an object cannot be put there, "" if it can."""
        if self.why[ping]:
            return self.why[ping]
        row = SIDES.index(side)
        nearest, farthest = float(self.nearest_m[row, ping]), float(self.farthest_m[row, ping])
        if math.isnan(farthest):
            return f"the log has no {side} samples there"
        if ground_range_m < nearest:
            return (
                f"too close to the nadir: from {nearest:.1f} m on the sea floor is seen at a grazing angle that shows "
                "objects"
            )
        if ground_range_m > farthest:
            return f"outside the swath: the sonar shows the sea floor up to {farthest:.1f} m"
        ratio = 1.0 + self.pitch_stretch[ping] - SIGN[side] * self.yaw_per_m[ping] * ground_range_m
        if not 1.0 / self.max_spacing_ratio <= ratio <= self.max_spacing_ratio:
            return "in a turn, where pings are spread or squeezed on the sea floor"
        return ""

    def plane_place(self, ping: int, side: Side, ground_range_m: float) -> tuple[float, float]:
        """Return east and north of a place abeam of a ping."""
        across, heading = SIGN[side] * ground_range_m, float(self.heading_rad[ping])
        return float(self.east_m[ping]) + across * math.cos(heading), float(self.north_m[ping]) - across * math.sin(
            heading
        )

    def draw(
        self, random: np.random.Generator, sides: Sequence[Side], low_m: float, high_m: float
    ) -> tuple[int, Side, float]:
        """Draw a ping, side and ground range, even over the sea floor seen between two ranges; high_m may be inf.

        Raises BadInputError if none is seen there.
        """
        step = np.minimum(np.diff(self.along_m, prepend=self.along_m[0]), 5.0)
        rows = [SIDES.index(side) for side in sides]
        near, far = np.maximum(self.nearest_m[rows], low_m), np.minimum(self.farthest_m[rows], high_m)
        good = np.array([not reason for reason in self.why])
        area = np.cumsum(np.where(good, np.nan_to_num(np.maximum(far - near, 0.0)) * step, 0.0).ravel())
        if area[-1] <= 0.0:
            where = f"between ground ranges {low_m:g} and {high_m:g} m" if math.isfinite(high_m) else "of the log"
            because = "" if good.any() else f"; mostly because: {Counter(self.why).most_common(1)[0][0]}"
            raise BadInputError(
                f"no sea floor {where} is shown well enough to put objects on it{because}. Give another range or log"
            )
        row, ping = divmod(
            int(np.searchsorted(area, random.uniform(0.0, area[-1]), side="right").clip(0, area.size - 1)),
            near.shape[1],
        )
        return ping, sides[row], float(random.uniform(near[row, ping], far[row, ping]))

    def looks(self, east_m: float, north_m: float) -> list[tuple[int, Side, float]]:
        """Return pings that look straight at a place that is shown well, each with side and ground range, in order."""
        ahead = (east_m - self.east_m) * np.sin(self.heading_rad) + (north_m - self.north_m) * np.cos(self.heading_rad)
        across = (east_m - self.east_m) * np.cos(self.heading_rad) - (north_m - self.north_m) * np.sin(self.heading_rad)
        same = self.stretch[1:] == self.stretch[:-1]
        passed = np.flatnonzero(same & (ahead[:-1] >= 0.0) & (ahead[1:] < 0.0))
        seen: list[tuple[int, Side, float]] = []
        for k in passed:
            ping = int(k + (abs(ahead[k + 1]) < abs(ahead[k])))
            side: Side = "starboard" if across[ping] > 0.0 else "port"
            if not self.refusal(ping, side, abs(float(across[ping]))):
                seen.append((ping, side, abs(float(across[ping]))))
        return seen


def heard_at(
    stretch: Stretch, pings: slice, side: Side, ground_range_m: float, sonar: SonarConfig
) -> tuple[Floats, Floats, Floats]:
    """Return latitude and longitude of what pings hear at a ground range, as the payload locates it, and its bearing.

    The bearing is in radians, clockwise from north.
    """
    first_return_m = stretch.first_return_m[pings]
    echoes = EchoGeometry(
        side=side,
        pose=slice_pose(stretch.poses, pings),
        slant_range_m=np.hypot(ground_range_m, first_return_m),
        first_return_m=first_return_m,
        sound_speed_mps=np.array([ping.sound_speed_mps for ping in stretch.pings[pings]]),
    )
    latitude, longitude, _ = locate(echoes, sonar)
    return latitude, longitude, np.radians(aspect_deg(echoes, sonar))


def track_of(survey: Survey, config: Config) -> PingTrack:
    """Compute the track of a log. Raises BadInputError if none of its pings has a position."""
    waterfall = config.waterfall
    latitude, longitude = _all_heard_at(survey, "starboard", 0.0, config.sonar)
    known = np.flatnonzero(np.isfinite(latitude) & np.isfinite(longitude))
    if not known.size:
        raise BadInputError(
            f"{survey.path} has no positions: a target's place cannot be computed. Give a log with navigation."
        )
    frame = LocalFrame(latitude_deg=float(latitude[known[0]]), longitude_deg=float(longitude[known[0]]))
    enu = frame.to_enu(latitude, longitude, 0.0)
    port, starboard = (frame.to_enu(*_all_heard_at(survey, side, _ABEAM_M, config.sonar), 0.0) for side in SIDES)
    across = starboard - port  # pitch and the way made meanwhile move both ahead alike

    def joined(name: str) -> Floats:
        return np.concatenate([getattr(stretch, name) for stretch in survey.stretches])

    def of_pose(name: str) -> Floats:
        return np.concatenate([getattr(stretch.poses, name) for stretch in survey.stretches])

    height = joined("first_return_m")
    speed = np.maximum(of_pose("speed_mps"), _MIN_SPEED_MPS)
    steepest, shallowest = math.radians(waterfall.max_grazing_deg), math.radians(waterfall.min_grazing_deg)
    nearest = np.empty((2, height.size))
    farthest = np.empty((2, height.size))
    for row, side in enumerate(SIDES):
        reach = np.concatenate([_reach_m(survey, k, side) for k in range(len(survey.stretches))])
        reach = np.minimum(reach, config.sonar.max_range_m)
        nearest[row] = height / math.tan(steepest) + _MARGIN_M
        farthest[row] = (
            np.minimum(np.sqrt(np.maximum(reach**2 - height**2, 0.0)), height / math.tan(shallowest)) - _MARGIN_M
        )
        farthest[row][~np.isfinite(reach)] = np.nan
    index = np.concatenate([np.arange(stretch.n_pings) for stretch in survey.stretches])
    count = np.concatenate([np.full(stretch.n_pings, stretch.n_pings) for stretch in survey.stretches])
    fast = np.abs(joined("yaw_rate_rad_s")) > math.radians(waterfall.max_turn_rate_deg_s)
    lost = ~np.isfinite(enu).all(axis=1) | ~np.isfinite(of_pose("heading_rad")) | of_pose("stale").astype(bool)
    blind = ~joined("bottom_seen").astype(bool)
    edge = (index < _MARGIN_PINGS) | (index >= count - _MARGIN_PINGS)
    return PingTrack(
        frame=frame,
        number=np.array([ping.number for stretch in survey.stretches for ping in stretch.pings], dtype=np.int64),
        stretch=np.concatenate([np.full(stretch.n_pings, k) for k, stretch in enumerate(survey.stretches)]),
        row=index,
        along_m=joined("along_m"),
        east_m=enu[:, 0],
        north_m=enu[:, 1],
        heading_rad=np.arctan2(across[:, 0], across[:, 1]) - 0.5 * math.pi,
        first_return_m=height,
        nearest_m=nearest,
        farthest_m=farthest,
        why=tuple(
            _whole_ping_reason(*flags)
            for flags in zip(lost.tolist(), blind.tolist(), fast.tolist(), edge.tolist(), strict=True)
        ),
        yaw_per_m=joined("yaw_rate_rad_s") / speed,
        pitch_stretch=height * joined("pitch_rate_rad_s") / speed,
        max_spacing_ratio=waterfall.max_spacing_ratio,
    )


def _all_heard_at(survey: Survey, side: Side, ground_range_m: float, sonar: SonarConfig) -> tuple[Floats, Floats]:
    """Return latitude and longitude of what `heard_at` gives for all pings."""
    parts = [heard_at(each, slice(None), side, ground_range_m, sonar)[:2] for each in survey.stretches]
    latitude, longitude = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return latitude, longitude


def _reach_m(survey: Survey, stretch: int, side: Side) -> Floats:
    """Return the slant range that each ping's trace reaches, NaN where the side was not recorded."""
    trace = survey.stretches[stretch].trace(0, side)
    reach = math.nan if trace is None else trace.first_range_m + trace.samples.shape[0] * trace.spacing_m
    return np.full(survey.stretches[stretch].n_pings, reach)


def _whole_ping_reason(lost: bool, blind: bool, fast: bool, edge: bool) -> str:
    if lost:
        return "the ping has no navigation"
    if blind:
        return "the bottom below the sonar is not seen there, so ranges on the sea floor are not known"
    if fast:
        return "in a turn, where pings are spread or squeezed on the sea floor"
    return "too close to the start or end of the recording, or to a gap in it" if edge else ""
