"""Sound the sea of one scene from anywhere: poses in, pings out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import UsageError
from auv_mcm.records import NAN, Ping
from sim_replay.simulator import rays
from sim_replay.simulator.bodies import Bodies, Body, near, pack
from sim_replay.simulator.echo import (
    absorption_db_per_km,
    beam_table,
    bin_ranges_m,
    flat_floor_intensity,
    floor_tables,
    material_tables,
    propagation,
    recorder_gain,
    vertical_pattern,
)
from sim_replay.simulator.objects import Material, PlacedObject, bodies_of, material_of, place_objects, points_of
from sim_replay.simulator.recording import complete, record
from sim_replay.simulator.render import Lines, render_pings
from sim_replay.simulator.scene import Scene, Sonar
from sim_replay.simulator.scene_file import check_scene
from sim_replay.simulator.speckle import gaussian_taps, lasting_rows, row_keys, speckle_rows
from sim_replay.simulator.vehicle import SonarPose
from sim_replay.simulator.world import SimulatedFloor

Floats = NDArray[np.float64]

_PORT_STREAM, _STARBOARD_STREAM = 0, 1 << 32
_NOISE_STREAMS: Final = 1 << 31  # beyond those of echoes that are correlated along the track


class Sea:
    """Combine world, objects and sonar of a scene. A ping depends on scene, seed, pose and ping number alone.

    sonar: the scene's, with the n_samples that are recorded. objects: all of them, placed. points: (n_points, 4) east,
    north, height above the datum (m) and target strength (m2) of echoes without a body. spreading: (n_samples,)
    received intensity per energy that comes back from a metre of width. reference: mean intensity of a flat floor
    midway between its first return and the end of the range; noise: that of noise. Raises UsageError for a scene that
    cannot be, or whose objects find no room.
    """

    def __init__(self, scene: Scene, *, threads: int = 1) -> None:
        check_scene(scene)
        sonar = _as_recorded(scene.sonar)
        self.scene: Final = scene
        self.sonar: Final = sonar
        self.world: Final = SimulatedFloor(scene.world, scene.seed)
        self.recorder: Final = complete(sonar.recorder)
        self._floor_tables = floor_tables(scene, self.world.covers)
        self._put(place_objects(scene))
        self._beam = beam_table(sonar.vertical_beam_width_deg)
        self._range_m = bin_ranges_m(sonar)
        self._absorption = absorption_db_per_km(sonar, scene.world.depth_m)
        width_m = math.radians(sonar.beam_width_deg) * self._range_m
        self.spreading: Final = width_m * propagation(self._range_m, self._absorption)
        reference_m = np.array([0.5 * (scene.track.altitude_m + sonar.range_m)])
        self.reference: Final = float(
            flat_floor_intensity(reference_m, scene.track.altitude_m, self._floor_tables[0], sonar, self._absorption)[0]
        )
        self.noise: Final = self.reference * 10.0 ** (0.1 * sonar.noise_db)
        self._gain = recorder_gain(self._range_m, sonar, self._absorption, float(reference_m[0]))
        self._taps = gaussian_taps(sonar.range_resolution_m / (sonar.range_m / sonar.n_samples))
        self._threads = threads

    def _put(self, objects: Sequence[PlacedObject]) -> None:
        materials: list[Material] = []
        bodies: list[Body] = []
        points: list[tuple[float, float, float, float]] = []
        for scene_object in objects:
            material = material_of(scene_object)
            if material not in materials:
                materials.append(material)
            bodies += bodies_of(scene_object, self.world.floor_m, len(self.world.covers) + materials.index(material))
            points += points_of(scene_object, self.world.floor_m)
        self.objects = tuple(objects)
        self.points = np.array(points).reshape(-1, 4)
        self._bodies = pack(bodies)
        self._tables = np.concatenate([self._floor_tables, material_tables(materials)])

    def altitude_m(self, pose: SonarPose) -> float:
        """Return the height of the sonar over the bare floor."""
        return self.scene.world.depth_m - pose.depth_m - self.world.floor_m(pose.east_m, pose.north_m)

    def mean_intensity(self, poses: Sequence[SonarPose]) -> Floats:
        """Return the mean received intensity, (n_poses, 2, n_samples), port first, without noise."""
        sonar, datum_m, cell_m = self.sonar, self.scene.world.depth_m, self.world.cell_m
        floor = np.array([self.world.floor_m(pose.east_m, pose.north_m) for pose in poses])
        fan = rays.fan(poses, floor, sonar, datum_m, cell_m)
        energy = self.energy(fan, 2 * len(poses), sonar.range_m / sonar.n_samples)
        intensity = energy.reshape(len(poses), 2, sonar.n_samples) * self.spreading
        self._add_points(intensity, poses)
        self.add_other_paths(intensity, poses, floor)
        return intensity

    def energy(self, fan: rays.Fan, n_rows: int, bin_m: float) -> Floats:
        """Return the energy that rays bring back from floor and bodies, (n_rows, n_samples).

        Spreading and absorption are not in it.
        """
        cell_m, n_bins = self.world.cell_m, self.sonar.n_samples
        needed, first_row, first_column = rays.crossed(fan, cell_m)
        patches = self.world.patches(needed, first_row, first_column)
        lines = rays.lines(fan, cell_m)
        bodies = self._bodies_near(fan)

        def part(rows: tuple[int, int]) -> Floats:
            mine = (lines.ping >= rows[0]) & (lines.ping < rows[1])
            own = Lines(**{name: values[mine] for name, values in lines._asdict().items()})._replace(
                ping=lines.ping[mine] - rows[0]
            )
            return render_pings(
                own,
                patches,
                bodies,
                self._tables,
                self._beam,
                cell_m=cell_m,
                n_nodes=fan.n_nodes,
                n_pings=rows[1] - rows[0],
                n_bins=n_bins,
                bin_m=bin_m,
            ).energy

        edges = np.linspace(0, n_rows, self._threads + 1).astype(int).tolist()
        spans = [(first, stop) for first, stop in pairwise(edges) if stop > first]
        if len(spans) == 1:
            return part(spans[0])
        with ThreadPoolExecutor(len(spans)) as pool:
            return np.concatenate(list(pool.map(part, spans)))

    def sound(
        self, poses: Sequence[SonarPose], first_number: int, altitudes_m: Sequence[float] | None = None
    ) -> list[Ping]:
        """Return pings numbered from `first_number`, one per pose.

        altitudes_m: by the sonar's altimeter, unknown if omitted.

        Raises UsageError where the floor leaves the sonar no water to be in.
        """
        for pose in poses:
            if pose.depth_m <= 0.0:
                raise UsageError(
                    f"`world.depth_m` {self.scene.world.depth_m:g} leaves the sonar above the surface at "
                    f"{pose.east_m:.0f} m east, {pose.north_m:.0f} m north, where the floor rises: give more, or a "
                    "gentler relief or slope"
                )
        return self.record(self.received(poses, first_number), poses, first_number, altitudes_m)

    def received(self, poses: Sequence[SonarPose], first_number: int) -> NDArray[np.float32]:
        """Return speckled intensity with noise of pings numbered from `first_number`, (n_poses, 2, n_samples).

        It is in units of `reference`, port first.
        """
        signal = self.mean_intensity(poses) * (1.0 / self.reference)
        sides = [
            self._speckled(signal[:, side], stream, first_number)
            for side, stream in enumerate((_PORT_STREAM, _STARBOARD_STREAM))
        ]
        return np.stack(sides, axis=1)

    def record(
        self,
        intensity: NDArray[np.float32],
        poses: Sequence[SonarPose],
        first_number: int,
        altitudes_m: Sequence[float] | None = None,
    ) -> list[Ping]:
        """Record pings of received intensity, (n_poses, 2, n_samples) in units of `reference`.

        The rest as in `sound`.
        """
        sonar = self.sonar
        reported_mps = sonar.sound_speed_mps + self.scene.navigation_error.sound_speed_bias_mps
        reported_bin_m = sonar.range_m / sonar.n_samples * reported_mps / sonar.sound_speed_mps
        n_ringing = round(sonar.ring_down_m / sonar.range_m * sonar.n_samples)
        traces = [record(intensity[:, side], self._gain, n_ringing, self.recorder, reported_bin_m) for side in range(2)]
        return [
            Ping(
                number=first_number + index,
                time_s=pose.time_s,
                port=traces[0][index],
                starboard=traces[1][index],
                sound_speed_mps=reported_mps,
                altitude_m=NAN if altitudes_m is None else altitudes_m[index],
                place=f"simulated ping {first_number + index}",
            )
            for index, pose in enumerate(poses)
        ]

    def _speckled(self, signal: Floats, stream: int, first_number: int) -> NDArray[np.float32]:
        """Return speckled intensity with noise of one side; signal: (n_pings, n_samples) in units of `reference`."""
        sonar, seed, noise = self.sonar, self.scene.seed, self.noise / self.reference
        streams = range(stream, stream + sonar.looks)
        if sonar.speckle_along_track_m == 0.0:
            return speckle_rows(signal + noise, row_keys(seed, streams, first_number, len(signal)), self._taps)
        along = gaussian_taps(sonar.speckle_along_track_m * sonar.ping_rate_hz / self.scene.track.speed_mps)
        of_looks = [(look, look + _NOISE_STREAMS) for look in streams]
        return lasting_rows(signal, noise, seed, of_looks, first_number, along, self._taps)

    def _bodies_near(self, fan: rays.Fan) -> Bodies:
        far_east, far_north = fan.east_m + fan.n_nodes * fan.step_east_m, fan.north_m + fan.n_nodes * fan.step_north_m
        return near(
            self._bodies,
            float(min(fan.east_m.min(), far_east.min())),
            float(max(fan.east_m.max(), far_east.max())),
            float(min(fan.north_m.min(), far_north.min())),
            float(max(fan.north_m.max(), far_north.max())),
        )

    def _add_points(self, intensity: Floats, poses: Sequence[SonarPose]) -> None:
        """Add echoes of points, which neither cast nor lie in shadows.

        Range r is seen from the vehicle's place r / c after transmission.
        """
        if not len(self.points):
            return
        sonar = self.sonar
        bin_m, beam_rad = sonar.range_m / sonar.n_samples, math.radians(sonar.beam_width_deg)
        east, north, height, strength = self.points.T
        for index, pose in enumerate(poses):
            sine, cosine = math.sin(pose.heading_rad), math.cos(pose.heading_rad)
            ahead = (east - pose.east_m) * sine + (north - pose.north_m) * cosine
            across = (east - pose.east_m) * cosine - (north - pose.north_m) * sine
            below = self.scene.world.depth_m - pose.depth_m - height
            slant = np.hypot(across, below / math.cos(pose.pitch_rad))
            drift = pose.speed_mps / sonar.sound_speed_mps * slant
            miss = ahead - below * math.tan(pose.pitch_rad) - drift * math.cos(pose.course_rad - pose.heading_rad)
            width = np.maximum(slant * beam_rad, pose.speed_mps / sonar.ping_rate_hz)
            for k in np.flatnonzero((np.abs(miss) < 2.0 * width) & (slant < sonar.range_m)):
                side = int(across[k] > 0.0)
                axis = math.radians(sonar.tilt_deg) + (pose.roll_rad if side else -pose.roll_rad)
                off = (below[k] * math.cos(axis) - abs(across[k]) * math.sin(axis)) / slant[k]
                echo = strength[k] * float(propagation(slant[k], self._absorption))
                echo *= float(vertical_pattern(np.asarray(off), sonar.vertical_beam_width_deg))
                echo *= math.exp(-4.0 * math.log(2.0) * (miss[k] / width[k]) ** 2)
                at = slant[k] / bin_m - 0.5
                low = math.floor(at)
                for column, part in ((low, low + 1 - at), (low + 1, at - low)):
                    if 0 <= column < sonar.n_samples:
                        intensity[index, side, column] += echo * part

    def add_other_paths(self, intensity: Floats, poses: Sequence[SonarPose], floor_m: Floats) -> None:
        """Add what comes by way of the surface and from the other side to intensity (n_poses, 2, n_samples).

        As far as the scene has it.

        floor_m: (n_poses,) height of the floor below the sonar above the datum.
        """
        sonar = self.sonar
        depth = np.array([pose.depth_m for pose in poses])[:, None]
        altitude = self.scene.world.depth_m - depth - floor_m[:, None]

        def mirrored(height_m: Floats, level_db: float) -> Floats:
            echo = flat_floor_intensity(self._range_m[None, :], height_m, self._tables[0], sonar, self._absorption)
            return np.asarray(echo * 10.0 ** (0.1 * level_db))[:, None, :]

        if sonar.surface_echo_db is not None:
            intensity += mirrored(depth, sonar.surface_echo_db)
        if sonar.second_bottom_db is not None:
            intensity += mirrored(2.0 * altitude + depth, sonar.second_bottom_db)
        if sonar.crosstalk_db is not None:
            intensity += intensity[:, ::-1].copy() * 10.0 ** (0.1 * sonar.crosstalk_db)


def _as_recorded(sonar: Sonar) -> Sonar:
    """Sample synthetic apertures at their resolution, whatever n_samples is."""
    aperture = sonar.synthetic_aperture
    if aperture is None:
        return sonar
    n_samples = round(sonar.range_m * aperture.pixels_per_resolution / aperture.range_resolution_m)
    return msgspec.structs.replace(sonar, n_samples=max(n_samples, 1), range_resolution_m=aperture.range_resolution_m)
