"""Read a sonar image with its sidecar as the pings that could have made it: one per line, in slant range.

Sub-apertures of a complex image come one after another, as if each were an image by itself.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.records import EchoTrace, NavSample, Notice, Ping, SourceEvent
from auv_mcm.settings.config import SonarConfig
from sim_replay.logs.image_looks import OVERLAP_LINES, doppler_centroid, mean_of_looks, sub_band
from sim_replay.logs.image_pixels import Pixels, open_pixels
from sim_replay.logs.image_place import Track, track_of
from sim_replay.logs.image_sidecar import Sidecar, read_sidecar, sidecar_path
from sim_replay.logs.image_stored import DamagedPixelsError
from sim_replay.logs.port_order import DECISIVE, port_order_evidence

_BLOCK_VALUES: Final = 1 << 21  # pixels worked on at once: bounds memory at some 100 MB, complex and float64
_MAX_BLOCK_LINES: Final = 1024  # lines read at once: narrow images gain nothing from more
_WATER_M: Final = 2.0  # of slant range before the first return, from which an image shows the water column
_PROBE_LINES: Final = 64  # looked at for the water column
_MIN_SPACING: Final = 0.25  # of the ground pixel: bounds the samples that near ranges cost
_MAX_SPREAD: Final = 8  # samples a ground pixel: twice what _MIN_SPACING needs at one altitude, bounds memory
_CENTROID_LINES: Final = 512  # that the middle of the Doppler spectrum is measured on


def kind_disagrees(path: Path, sidecar: Sidecar, sonar: SonarConfig) -> Notice:
    """Write the notice that the configured kind of sonar is not the sidecar's."""
    text = (
        f"the sidecar says `kind: {sidecar.kind}`, the configuration sonar.kind: {sonar.kind}. Correct the one that is "
        "wrong"
    )
    return Notice(code="reader.kind_disagrees", text=text, place=str(path))


class ImageLog:
    """Read one image. Iterate for NavSample, Ping and Notice; `counters` fill meanwhile. Every iteration starts anew.

    Memory does not depend on the number of lines, but for pictures that cannot be read in parts. Counts reader.pings
    and reader.image_damaged.
    """

    def __init__(self, path: Path, container: str, sonar: SonarConfig) -> None:
        """Open the image and its sidecar. Raises BadInputError where they cannot be used together.

        container: tiff, png, npy or hdf5.
        """
        self._path, self._sonar = path, sonar
        self._size_bytes = path.stat().st_size
        self.sidecar: Final[Sidecar] = read_sidecar(path)
        self._pixels: Pixels = open_pixels(path, container, self.sidecar)
        self._track: Track = track_of(
            path, self.sidecar, self._pixels.n_lines, self._pixels.n_pixels, self._pixels.geo_tags
        )
        self._grid = self._slant_grid()
        self._refuse_turned()
        self.counters: Counter[str] = Counter()
        self._fraction = 0.0

    @property
    def sizes_bytes(self) -> dict[Path, int]:
        """Return the size of the image, its sidecar and its track."""
        others = [sidecar_path(self._path)]
        if self.sidecar.track is not None:
            others.append(self._path.parent / self.sidecar.track)
        return {self._path: self._size_bytes} | {path: path.stat().st_size for path in others}

    @property
    def bytes_read(self) -> int:
        """Estimate the bytes read so far by the share of lines."""
        return round(self._fraction * self._size_bytes)

    def first_time_s(self) -> float:
        """Return the time of the first line, s since 1970."""
        return self.sidecar.start_s

    def __iter__(self) -> Iterator[SourceEvent]:
        self.counters.clear()
        yield from self._notices()
        spacing_m, first_m, n_samples = self._grid
        edges_m: NDArray[np.float64] = np.asarray(first_m + (np.arange(n_samples + 1) - 0.5) * spacing_m, np.float64)
        n_lines = self._pixels.n_lines
        block = max(1, min(_MAX_BLOCK_LINES, _BLOCK_VALUES // self._pixels.n_pixels))
        parts: list[int | None] = [None] if self.sidecar.sub_apertures is None else [*range(self.sidecar.sub_apertures)]
        for n_read, part in enumerate(parts):
            for first in range(0, n_lines, block):
                stop = min(first + block, n_lines)
                try:
                    with np.errstate(over="ignore", invalid="ignore"):  # of numbers that intake drops
                        intensity = self._intensity(first, stop, part)
                except DamagedPixelsError as error:
                    self.counters["reader.image_damaged"] += not n_read
                    text = f"{error}: the image is used up to line {first} of {n_lines}. Copy or export it again."
                    if not n_read:
                        yield Notice(code="reader.image_damaged", text=text, place=str(self._path))
                    break
                if self.sidecar.range == "ground":
                    intensity = self._to_slant(intensity, edges_m, self._track.altitude_m[first:stop])
                for line, samples in enumerate(intensity, first):
                    trace = EchoTrace(samples=samples, first_range_m=first_m, spacing_m=spacing_m)
                    yield from self._events(line, trace, part)
                self.counters["reader.pings"] += stop - first
                self._fraction = (n_read + stop / n_lines) / len(parts)

    def _events(self, line: int, trace: EchoTrace, part: int | None) -> Iterator[SourceEvent]:
        sidecar, track = self.sidecar, self._track
        time_s = sidecar.start_s + line * sidecar.pixel_along_m / sidecar.speed_mps
        altitude_m = float(track.altitude_m[line])
        yield NavSample(
            time_s=time_s,
            latitude_deg=float(track.latitude_deg[line]),
            longitude_deg=float((track.longitude_deg[line] + 180.0) % 360.0 - 180.0),
            heading_rad=float(track.heading_rad[line]),
            pitch_rad=0.0,
            roll_rad=0.0,
            altitude_m=altitude_m,
            speed_mps=sidecar.speed_mps,
        )
        is_port = sidecar.side == "port"
        yield Ping(
            number=line + (part or 0) * self._pixels.n_lines,
            time_s=time_s,
            port=trace if is_port else None,
            starboard=None if is_port else trace,
            sound_speed_mps=sidecar.sound_speed_mps,
            altitude_m=altitude_m,
            place=f"{self._path.name}, line {line}" + ("" if part is None else f", sub-aperture {part + 1}"),
            transfer="intensity",
            squint_rad=self._squint_rad(part),
        )

    def _notices(self) -> Iterator[Notice]:
        sidecar = self.sidecar
        if sidecar.kind != self._sonar.kind:
            yield kind_disagrees(self._path, sidecar, self._sonar)
        spacing_m, first_m, n_samples = self._grid
        far_m = first_m + (n_samples - 0.5) * spacing_m
        if far_m > self._sonar.max_range_m:
            text = (
                f"the image reaches to {far_m:.0f} m of slant range, sonar.max_range_m is "
                f"{self._sonar.max_range_m:g}: what lies beyond is left out. Raise it to search all of it."
            )
            yield Notice(code="reader.beyond_max_range", text=text, place=str(self._path))

    def _squint_rad(self, part: int | None) -> float:
        """Compute the middle of the bearings of a sub-aperture: over the aperture they grow with frequency, linearly up
        to the cube of the angle."""
        sidecar = self.sidecar
        if part is None:
            return math.radians(sidecar.squint_deg)
        assert sidecar.sub_apertures is not None
        assert sidecar.integration_deg is not None
        middle = self._centroid / self._band + (part + 0.5) / sidecar.sub_apertures - 0.5
        sign = 1.0 if sidecar.positive_doppler == "ahead" else -1.0
        return math.radians(sidecar.squint_deg) + sign * middle * math.radians(sidecar.integration_deg)

    @property
    def _band(self) -> float:
        """Return the share of the sampled spectrum that the aperture fills."""
        sidecar = self.sidecar
        return min(1.0, sidecar.pixel_along_m / (sidecar.resolution_along_m or sidecar.pixel_along_m))

    def _intensity(self, first: int, stop: int, part: int | None = None) -> NDArray[np.float32]:
        """Read lines [first, stop) as linear intensity, (stop - first, n_pixels), of a sub-aperture or of all."""
        sidecar = self.sidecar
        if sidecar.samples == "complex":
            return self._of_complex(first, stop, part)
        stored = self._pixels.read(first, stop)
        if sidecar.samples == "amplitude":
            values = stored.astype(np.float32)
            # What is negative is no amplitude: left negative, intake drops it.
            return np.where(values < 0.0, values, values * values)
        if sidecar.samples == "log":
            assert sidecar.db_per_count is not None
            decibels = stored.astype(np.float64) * sidecar.db_per_count
            return np.power(10.0, np.clip(decibels / 10.0, -30.0, 30.0)).astype(np.float32)
        return stored.astype(np.float32)

    def _of_complex(self, first: int, stop: int, part: int | None) -> NDArray[np.float32]:
        sidecar = self.sidecar
        if sidecar.looks == 1 and part is None:
            image = self._pixels.read(first, stop)
            return np.asarray(image.real.astype(np.float32) ** 2 + image.imag.astype(np.float32) ** 2)
        before, after = min(first, OVERLAP_LINES), min(self._pixels.n_lines - stop, OVERLAP_LINES)
        image = self._pixels.read(first - before, stop + after)
        if first == 0:
            self._centroid = doppler_centroid(image[:_CENTROID_LINES])
        if part is None:
            looks = mean_of_looks(image, sidecar.looks, self._centroid, self._band)
        else:
            assert sidecar.sub_apertures is not None
            looks = sub_band(image, sidecar.sub_apertures, part, self._centroid, self._band)
        return looks[before : before + stop - first]

    # --- ground range ---

    def _slant_grid(self) -> tuple[float, float, int]:
        """Choose spacing, first range and number of samples of all lines. Raises BadInputError for too many."""
        sidecar, altitude_m = self.sidecar, self._track.altitude_m
        if sidecar.range == "slant":
            spacing_m = sidecar.pixel_across_m
            return spacing_m, sidecar.near_range_m + 0.5 * spacing_m, self._pixels.n_pixels
        near_m, far_m = sidecar.near_range_m, sidecar.near_range_m + self._pixels.n_pixels * sidecar.pixel_across_m
        near_slant_m = math.hypot(near_m, float(altitude_m.min()))
        far_slant_m = math.hypot(far_m, float(altitude_m.max()))
        finest = max(near_m / math.hypot(near_m, float(altitude_m.max())), _MIN_SPACING)
        spacing_m = sidecar.pixel_across_m * finest
        n_samples = math.ceil((far_slant_m - near_slant_m) / spacing_m)
        if n_samples > max(_MAX_SPREAD * self._pixels.n_pixels, _BLOCK_VALUES // _MAX_BLOCK_LINES):
            raise BadInputError(
                f"{self._path}: with altitudes from {altitude_m.min():g} to {altitude_m.max():g} m a line of "
                f"{self._pixels.n_pixels} pixels reaches over {n_samples} samples in slant range. Correct the altitude."
            )
        return spacing_m, near_slant_m + 0.5 * spacing_m, n_samples

    def _to_slant(
        self, intensity: NDArray[np.float32], edges_m: NDArray[np.float64], altitude_m: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Average pixels over slant bins, NaN where a bin reaches beyond the image."""
        sidecar = self.sidecar
        n_pixels = intensity.shape[1]
        result = np.empty((len(intensity), edges_m.size - 1), dtype=np.float32)
        place = np.empty(0)
        for row, (line, altitude) in enumerate(zip(intensity, altitude_m, strict=True)):
            if row == 0 or altitude != altitude_m[row - 1]:
                ground_m = np.sqrt(np.maximum(edges_m**2 - altitude**2, 0.0))
                place = (ground_m - sidecar.near_range_m) / sidecar.pixel_across_m
            inside = np.clip(place, 0.0, n_pixels)
            sums = np.concatenate([[0.0], np.cumsum(np.where(np.isfinite(line), line, 0.0), dtype=np.float64)])
            counts = np.concatenate([[0.0], np.cumsum(np.isfinite(line), dtype=np.float64)])
            pixels = np.arange(n_pixels + 1)
            total, weight = np.diff(np.interp(inside, pixels, sums)), np.diff(np.interp(inside, pixels, counts))
            half = 0.5 * np.diff(place)
            whole = (weight > half) & (half > 0.0)
            result[row] = np.where(whole, total / np.where(whole, weight, 1.0), np.nan)
        return result

    # --- what the picture shows of itself ---

    def _refuse_turned(self) -> None:
        """Refuse an image whose water column lies at the edge that the sidecar calls far."""
        sidecar = self.sidecar
        altitude_m = float(self._track.altitude_m.min())
        if sidecar.range != "slant" or sidecar.near_range_m > altitude_m - _WATER_M or sidecar.samples == "complex":
            return
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                lines = self._intensity(0, min(_PROBE_LINES, self._pixels.n_lines))
        except DamagedPixelsError as error:
            raise BadInputError(f"{self._path}: {error}. Copy or export it again.") from error
        evidence = port_order_evidence(np.nan_to_num(lines), None, sidecar.pixel_across_m, self._sonar.blank_m)
        if evidence.water_column > 0.0 and evidence.total >= 2.0 * DECISIVE:
            raise BadInputError(
                f"{self._path}: the dark water column lies at the far edge (evidence {evidence.total:+.2f}). The "
                f"picture is turned: `near_edge: {sidecar.near_edge}` in the sidecar should be the opposite edge."
            )
