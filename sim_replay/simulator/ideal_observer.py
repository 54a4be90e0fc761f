"""Decide as an observer would who knows floor, pose and the law of speckle: what no detector can do better.

The mean of every sample is known with and without an object. A sample of L looks with mean m follows a Gamma
distribution of shape L, so that of independent samples x

    ln p(x | with) / p(x | without) = sum of L (ln(m0 / m1) + x (1 / m0 - 1 / m1)),

m1 and m0 being the means with and without (S. M. Kay, Fundamentals of Statistical Signal Processing II, 1998, ch. 3:
no other statistic finds more at as many false alarms). Neighbouring samples share speckle. The sum is divided by the
number of samples that are worth one, which makes it the mean of the ratios of sparse samples that are independent:
then E[exp(ratio)] <= 1 without an object (Hoelder's inequality), and a ratio above t comes by chance in exp(-t) of the
cases at most (Markov's inequality).

The recorder's rounding and clipping are left out, and errors of navigation: the observer knows where the sonar was.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_replay.simulator.objects import USUAL, PlacedObject
from sim_replay.simulator.scene import ObjectKind
from sim_replay.simulator.sea import Sea
from sim_replay.simulator.truth import seen_ranges_m
from sim_replay.simulator.vehicle import SonarPose

Floats = NDArray[np.float64]

_MARGIN_M: Final = 1.0  # m along the track beyond an object and the beam: what pitch and drift may move it by
_BESIDE_M: Final = 4.0  # m along the track: what the beam and 2 degrees of yaw over 60 m bring into the same rows
_AZIMUTHS: Final[dict[ObjectKind, int]] = {"cylinder": 6, "wedge": 8, "box": 6, "truncated_cone": 1, "sphere": 1}
"""Azimuths per kind of mine in the library, on half a turn where opposite ones look alike, a whole one for wedges."""
_SPHERE_WIDTHS_M: Final = (0.6, 0.8, 1.0)  # the range of the named scenes
_STRENGTHS_DB: Final = (0.0, -6.0)
"""Strengths of the library's mines against what lies there: smooth walls glint by as much as 10 dB, a rock's do not."""
_FIRST_SEED: Final = 1_000_000  # of the library's rocks: no scene draws one of them


class Passage(NamedTuple):
    """Hold the pings of one passage that may show a place: poses, the first one's number, and the side, 0 for port."""

    poses: tuple[SonarPose, ...]
    first_number: int
    side: int


def log_ratio(
    received: ArrayLike, mean_with: ArrayLike, mean_without: ArrayLike, *, looks: int = 1, samples_per_look: float = 1.0
) -> float:
    """Compute the log-likelihood ratio of samples for an object against none, nats.

    received, mean_with, mean_without: intensities above 0 that broadcast. samples_per_look: correlated samples that are
    worth one.
    """
    with_it, without = np.asarray(mean_with, dtype=np.float64), np.asarray(mean_without, dtype=np.float64)
    x = np.asarray(received, dtype=np.float64)
    terms = np.log(without / with_it) + x * (1.0 / without - 1.0 / with_it)
    return looks / samples_per_look * float(np.sum(terms))


def log_mean_exp(values: ArrayLike) -> float:
    """Compute ln of the mean of exp(values), (n,): the ratio of hypotheses that are equally likely beforehand."""
    some = np.asarray(values, dtype=np.float64)
    highest = float(some.max())
    return highest + math.log(float(np.exp(some - highest).mean()))


class IdealObserver:
    """Know a sea, and the poses of all pings of a mission through it, in order from ping 0 on.

    The objects of the sea are what really lies there. Where an object is in question all others are known. A scene with
    a synthetic aperture is not covered.
    """

    def __init__(self, sea: Sea, poses: Sequence[SonarPose]) -> None:
        self._sea = sea
        self._poses = tuple(poses)
        names = ("east_m", "north_m", "heading_rad", "on_leg")
        self._track = np.array([[getattr(pose, name) for name in names] for pose in poses]).reshape(-1, len(names))

    def passages(self, place: PlacedObject) -> Iterator[Passage]:
        """Find the passages on legs that saw a place within the ranges that count as seen, as truth.json has them."""
        sea, (east, north, heading, leg) = self._sea, self._track.T
        sonar = sea.sonar
        ahead = (place.east_m - east) * np.sin(heading) + (place.north_m - north) * np.cos(heading)
        across = (place.east_m - east) * np.cos(heading) - (place.north_m - north) * np.sin(heading)
        reach_m = place.reach_m + _MARGIN_M + math.radians(sonar.beam_width_deg) * np.abs(across)
        passed = np.flatnonzero((ahead[:-1] >= 0.0) & (ahead[1:] < 0.0) & (leg[:-1] >= 0.0) & (leg[:-1] == leg[1:]))
        for k in passed.tolist():
            nearest, farthest = seen_ranges_m(sea.altitude_m(self._poses[k]), sonar.range_m)
            if not nearest <= abs(across[k]) <= farthest:
                continue
            outside = np.flatnonzero(np.abs(ahead) > reach_m)
            first = int(np.max(outside[outside < k], initial=-1)) + 1
            stop = int(np.min(outside[outside > k], initial=len(ahead)))
            yield Passage(self._poses[first:stop], first, int(across[k] > 0.0))

    def log_ratios(self, place: PlacedObject, hypotheses: Sequence[PlacedObject]) -> Floats:
        """Compute the log-likelihood ratio of each hypothesis against bare floor at a place, (n,) nats.

        Over all passages that saw it; zeros if none did. place: what may really lie there, an object of the sea, is
        taken out before the hypothesis is put in.
        """
        sea = self._sea
        passages = list(self.passages(place))
        others = [other for other in sea.objects if other is not place and _may_show(other, place, passages)]
        bare = sea.with_objects(others)
        received = [sea.received(passage.poses, passage.first_number) for passage in passages]
        without = [bare.mean_received(passage.poses) for passage in passages]
        ratios = np.zeros(len(hypotheses))
        for index, hypothesis in enumerate(hypotheses):
            imagined = sea.with_objects([*others, hypothesis])
            for passage, x, mean in zip(passages, received, without, strict=True):
                ratios[index] += log_ratio(
                    x[:, passage.side],
                    imagined.mean_received(passage.poses)[:, passage.side],
                    mean[:, passage.side],
                    looks=sea.scene.sonar.looks,
                    samples_per_look=sea.samples_per_look,
                )
        return ratios


def _may_show(other: PlacedObject, place: PlacedObject, passages: Sequence[Passage]) -> bool:
    """Check whether an object may lie in the rows of passages of a place."""
    for passage in passages:
        pose = passage.poses[len(passage.poses) // 2]
        ahead_m = (other.east_m - place.east_m) * math.sin(pose.heading_rad)
        ahead_m += (other.north_m - place.north_m) * math.cos(pose.heading_rad)
        if abs(ahead_m) <= place.reach_m + other.reach_m + _BESIDE_M:
            return True
    return False


def mine_library(place: PlacedObject) -> list[PlacedObject]:
    """List mines of usual sizes that might lie at a place, as deep in the floor as what does, in all directions."""
    library = []
    for kind, n_azimuths in _AZIMUTHS.items():
        usual = USUAL[kind]
        turn_rad = 2.0 * math.pi if kind == "wedge" else math.pi
        widths = _SPHERE_WIDTHS_M if kind == "sphere" else (usual.width_m,)
        for width in widths:
            for step in range(n_azimuths):
                for strength in _STRENGTHS_DB:
                    library.append(
                        place._replace(
                            kind=kind,
                            azimuth_rad=place.azimuth_rad + turn_rad * step / n_azimuths,
                            tilt_rad=0.0,
                            length_m=width if kind == "sphere" else usual.length_m,
                            width_m=width,
                            height_m=width if kind == "sphere" else usual.height_m,
                            top_m=usual.top_m,
                            strength_db=place.strength_db + strength,
                            specular_db=usual.specular_db,
                            is_target=True,
                        )
                    )
    return library


def rock_library(place: PlacedObject, n: int) -> list[PlacedObject]:
    """List n rocks of other shapes that might lie at a place, as long, wide, high and bright as what does."""
    specular_db = USUAL["rock"].specular_db
    return [
        place._replace(kind="rock", tilt_rad=0.0, specular_db=specular_db, is_target=False, seed=_FIRST_SEED + number)
        for number in range(n)
    ]
