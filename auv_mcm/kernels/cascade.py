"""Run the trained cascade's hot loops: codes, integral images modulo 2**32, and boosted stumps on live windows.

A stump compares sums s of codes over boxes in float32, in this order of operations: f(s_a) w_a < f(s_b) w_b, or for a
contrast f(s_a) w_a - f(s_b) w_b < f(s_w) w_w, with f rounding to nearest. Scores are whole numbers, so that the order
of adding up does not matter. Windows are places in an integral image: the index of the pixel's first corner.

C and numpy agree to the bit.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.kernels.signatures import call

# integer that stands for the sea floor's mean: steps of 0.1 %; with MAX_INTENSITY it fits 16 bits
CODE_OF_MEAN: Final = 1024
MAX_INTENSITY: Final = 16.0  # times the mean: 12 dB, above which a highlight counts as that bright

STUMP: Final = np.dtype(
    [("offset", np.int32, (3, 4)), ("weight", np.float32, 3), ("leaf", np.int32, 2), ("contrast", np.int32)]
)
"""One stump in one band. offset: of boxes a, b, w to their lower right, upper right, lower left and upper left corners
in an integral image, from the window's place. leaf: what the score gains where the comparison fails, and where it
holds."""

_AT_ONCE: Final = 32768  # windows that numpy weighs together: more no longer fit the cache
_WEIGHED_AT_ONCE: Final = 1 << 14  # places times stumps that numpy weighs in one go; more go stump by stump


class Tables(NamedTuple):
    """Hold a model made for one pixel size and one length of rows.

    stumps: (n_bands, n_stumps) STUMP. groups: (n_groups, 2) int32, number of stumps up to each group's end, and the
    score below which windows are dropped there. window: (n_bands, 4) int32 corners, as in STUMP, of the box of which at
    least `least` pixels (n_bands,) int32 must be valid. restart: whether scores start at 0 in every group.
    """

    stumps: NDArray[np.void]
    groups: NDArray[np.int32]
    window: NDArray[np.int32]
    least: NDArray[np.int32]
    restart: bool


class WindowField(NamedTuple):
    """Hold integral images, and where in them windows may be centred.

    sums, counts: integral images of codes and of valid pixels, uint32 of one shape; corner: index of pixel (0, 0) in
    them, which leaves as much margin as boxes reach and one row more. usable: (n_rows, n_columns) bool. edges: (n_rows,
    n_bands + 1) int32 columns at which bands begin, the last one n_columns.
    """

    sums: NDArray[np.uint32]
    counts: NDArray[np.uint32]
    corner: int
    usable: NDArray[np.bool_]
    edges: NDArray[np.int32]


class Windows(NamedTuple):
    """Hold live windows by band: band k holds [band_stop[k - 1], band_stop[k]).

    place, score: (n,) int32; band_stop: (n_bands,) int64.
    """

    place: NDArray[np.int32]
    score: NDArray[np.int32]
    band_stop: NDArray[np.int64]


class Opened(NamedTuple):
    """Hold what the first groups left.

    windows: alive after the first groups, in a band by row and column. n_windows: weighed. n_alive: after each group,
    (n_groups,).
    """

    windows: Windows
    n_windows: int
    n_alive: NDArray[np.int64]


def encode(intensity: NDArray[np.float32], mask: NDArray[np.uint8]) -> tuple[NDArray[np.uint16], NDArray[np.bool_]]:
    """Encode intensities of any shape as codes uint16, and give where they are valid, bool.

    A code is 1024 times the intensity, nearest and halves to even, 0 to 16384; 1024 where not valid. mask: same shape;
    its lowest bit marks that an echo was measured. NaN is never valid. Raises ValueError if the shapes differ.
    """
    _same_shape(intensity, mask)
    codes, valid = np.empty(intensity.shape, dtype=np.uint16), np.empty(intensity.shape, dtype=np.bool_)
    if not call("cascade_encode", intensity.size, intensity, mask, codes, valid):
        return encode_numpy(intensity, mask)
    return codes, valid


def encode_numpy(
    intensity: NDArray[np.float32], mask: NDArray[np.uint8]
) -> tuple[NDArray[np.uint16], NDArray[np.bool_]]:
    """Do as encode, in numpy alone."""
    valid = ((mask & 1) != 0) & ~np.isnan(intensity)
    bounded = np.clip(np.where(valid, intensity, np.float32(1.0)), np.float32(0.0), np.float32(MAX_INTENSITY))
    return np.asarray(np.rint(bounded * np.float32(CODE_OF_MEAN)), dtype=np.uint16), valid


def integral(values: NDArray[Any], margins: tuple[int, int, int], beyond: int) -> NDArray[np.uint32]:
    """Compute the integral image modulo 2**32 of a plane that goes on as `beyond` in its margins.

    Returns (n_rows + 2 rows + 1, n_columns + before + behind + 1) uint32; element (i, j) is the sum over the padded
    plane's rows before i and columns before j.

    Parameters
    ----------
    values
        (n_rows, n_columns) uint16, or bool.
    margins
        Rows either way, columns before, columns behind.

    Raises
    ------
    ValueError
        For other types.
    """
    if values.dtype not in (np.dtype(np.uint16), np.dtype(np.bool_)):
        raise ValueError(f"values must be uint16 or bool, not {values.dtype}")
    rows, before, behind = margins
    sums = np.empty((values.shape[0] + 2 * rows + 1, values.shape[1] + before + behind + 1), dtype=np.uint32)
    name = "cascade_sums" if values.dtype == np.uint16 else "cascade_counts"
    if not call(name, *values.shape, *margins, beyond, values, sums):
        return integral_numpy(values, margins, beyond)
    return sums


def integral_numpy(values: NDArray[Any], margins: tuple[int, int, int], beyond: int) -> NDArray[np.uint32]:
    """Do as integral, in numpy alone."""
    rows, before, behind = margins
    padded = np.pad(values.astype(np.uint32), ((rows, rows), (before, behind)), constant_values=beyond)
    sums = np.zeros((padded.shape[0] + 1, padded.shape[1] + 1), dtype=np.uint32)
    np.cumsum(np.cumsum(padded, axis=1, dtype=np.uint32), axis=0, dtype=np.uint32, out=sums[1:, 1:])
    return sums


def open_windows(field: WindowField, tables: Tables, n_groups: int) -> Opened:
    """Run the first n_groups groups on all windows of a field; with none the windows are only counted."""
    n_bands, n_stumps = tables.stumps.shape
    room = int(np.count_nonzero(field.usable)) + 1
    windows = Windows(np.empty(room, dtype=np.int32), np.empty(room, dtype=np.int32), np.empty(n_bands, dtype=np.int64))
    n_alive, n_windows = np.empty(n_groups, dtype=np.int64), np.empty(1, dtype=np.int64)
    shape = *field.usable.shape, field.sums.shape[1], field.corner
    planes, bands = (field.sums, field.counts, field.usable), (n_bands, field.edges, tables.window, tables.least)
    stages = n_stumps, tables.stumps, n_groups, tables.groups, tables.restart
    if not call("cascade_open", *shape, *planes, *bands, *stages, *windows, n_alive, n_windows):
        return open_windows_numpy(field, tables, n_groups)
    return Opened(_first(windows), int(n_windows[0]), n_alive)


def open_windows_numpy(field: WindowField, tables: Tables, n_groups: int) -> Opened:
    """Do as open_windows, in numpy alone."""
    sums, counts, corner, usable, edges = field
    n_bands = tables.window.shape[0]
    widths = np.diff(edges, axis=1)
    band = np.repeat(np.tile(np.arange(n_bands, dtype=np.uint8), len(edges)), widths.ravel())[usable.ravel()]
    rows, columns = np.nonzero(usable)
    place = (corner + rows * sums.shape[1] + columns).astype(np.int32)[np.argsort(band, kind="stable")]
    stop = np.cumsum(np.bincount(band, minlength=n_bands))
    whole, band_stop, begin = [], np.empty(n_bands, dtype=np.int64), 0
    for k in range(n_bands):
        some = place[begin : stop[k]]
        whole.append(some[_Boxes(counts.ravel(), some).sum(tables.window[k]) >= tables.least[k]])
        band_stop[k] = (band_stop[k - 1] if k else 0) + len(whole[-1])
        begin = int(stop[k])
    chosen = np.concatenate(whole)
    if n_groups == 0:
        return Opened(
            Windows(chosen[:0], chosen[:0], np.zeros_like(band_stop)), len(chosen), np.zeros(0, dtype=np.int64)
        )
    windows, n_alive = run_groups_numpy(sums, tables, Windows(chosen, np.zeros_like(chosen), band_stop), 0, n_groups)
    return Opened(windows, len(chosen), n_alive)


def run_groups(
    sums: NDArray[np.uint32], tables: Tables, windows: Windows, first: int, last: int
) -> tuple[Windows, NDArray[np.int64]]:
    """Run groups [first, last) on windows. Returns those alive, in order, and their number after each group.

    Raises ValueError unless places rise within each band and bands hold all windows.
    """
    _check_order(windows)
    # A copy, which the kernel works in, with room for one more.
    place, score = (np.append(values, np.int32(0)) for values in windows[:2])
    copied, n_alive = Windows(place, score, windows.band_stop.copy()), np.empty(last, dtype=np.int64)
    stages = *tables.stumps.shape, tables.stumps, first, last, tables.groups, tables.restart
    if not call("cascade_run", sums, *stages, *copied, n_alive):
        return run_groups_numpy(sums, tables, windows, first, last)
    return _first(copied), n_alive[first:]


def run_groups_numpy(
    sums: NDArray[np.uint32], tables: Tables, windows: Windows, first: int, last: int
) -> tuple[Windows, NDArray[np.int64]]:
    """Do as run_groups, in numpy alone."""
    flat, n_alive = sums.ravel(), np.zeros(last - first, dtype=np.int64)
    places, scores = [windows.place[:0]], [windows.score[:0]]
    band_stop, begin = np.zeros_like(windows.band_stop), 0
    for band, stop in enumerate(windows.band_stop):
        kept = 0
        for start in range(begin, int(stop), _AT_ONCE):
            part = slice(start, min(start + _AT_ONCE, int(stop)))
            place, score = windows.place[part], windows.score[part].copy()
            for group in range(first, last):
                if tables.restart:
                    score[:] = 0
                first_stump = tables.groups[group - 1, 0] if group else 0
                score += _weighed(flat, place, tables.stumps[band, first_stump : tables.groups[group, 0]])
                alive = score >= tables.groups[group, 1]
                place, score = place[alive], score[alive]
                n_alive[group - first] += len(place)
            places.append(place)
            scores.append(score)
            kept += len(place)
        band_stop[band] = (band_stop[band - 1] if band else 0) + kept
        begin = int(stop)
    return Windows(np.concatenate(places), np.concatenate(scores), band_stop), n_alive


def rank(score: NDArray[np.int32], n_first: int) -> NDArray[np.int32]:
    """Rank scores (n,) int32 from the highest down, of equal ones the first first: int32 indices.

    Ranked are the n_first highest, 1 or more, and all that equal the last of those.
    """
    n_first = min(max(n_first, 1), score.size)
    order, scratch = (np.empty(score.size, dtype=np.int32) for _ in range(2))
    n_ranked = np.empty(1, dtype=np.int64)
    if score.size == 0 or not call("cascade_rank", score.size, score, n_first, order, scratch, n_ranked):
        return rank_numpy(score, n_first)
    return order[: n_ranked[0]]


def rank_numpy(score: NDArray[np.int32], n_first: int) -> NDArray[np.int32]:
    """Do as rank, in numpy alone."""
    n_first = min(max(n_first, 1), score.size)
    order = np.argsort(-score.astype(np.int64), kind="stable").astype(np.int32)
    return order[: np.count_nonzero(score >= score[order[n_first - 1]])] if order.size else order


def corners(boxes_px: NDArray[np.int32], stride: int) -> NDArray[np.int32]:
    """Compute offsets (..., 4) int32 of STUMP for boxes (..., 4).

    Boxes are top, bottom, left, right in an integral image with rows of `stride`.
    """
    top, bottom, left, right = np.moveaxis(boxes_px, -1, 0)
    offsets = (bottom * stride + right, top * stride + right, bottom * stride + left, top * stride + left)
    return np.ascontiguousarray(np.stack(offsets, axis=-1), dtype=np.int32)


def _weighed(flat: NDArray[np.uint32], place: NDArray[np.int32], stumps: NDArray[np.void]) -> NDArray[np.int32]:
    """Sum what stumps (n,) say of places (m,): (m,) int32. Few places are weighed by all stumps at once."""
    if place.size * stumps.size > _WEIGHED_AT_ONCE:
        boxes, total = _Boxes(flat, place), np.zeros(place.size, dtype=np.int32)
        for stump in stumps:
            total += _weigh(boxes, stump)
        return total
    corner = flat[stumps["offset"][..., np.newaxis] + place]
    sums = ((corner[:, :, 0] - corner[:, :, 1]) - (corner[:, :, 2] - corner[:, :, 3])).view(np.int32)
    first, second, shared = np.moveaxis(sums.astype(np.float32) * stumps["weight"][..., np.newaxis], 1, 0)
    contrast = stumps["contrast"][:, np.newaxis].astype(np.bool_)
    holds = np.where(contrast, first - second, first) < np.where(contrast, shared, second)
    otherwise, where_it_holds = stumps["leaf"].T[..., np.newaxis]
    return np.asarray(np.where(holds, where_it_holds, otherwise).sum(axis=0, dtype=np.int32))


def _weigh(boxes: _Boxes, stump: NDArray[np.void]) -> NDArray[np.int32]:
    a, b = (boxes.sum(stump["offset"][k]).astype(np.float32) for k in range(2))
    a *= stump["weight"][0]
    b *= stump["weight"][1]
    if stump["contrast"]:
        a -= b
        b = boxes.shared_sum(stump["offset"][2]) * stump["weight"][2]
    otherwise, where_it_holds = stump["leaf"]
    return np.asarray(np.where(a < b, where_it_holds, otherwise), dtype=np.int32)


class _Boxes:
    """Sum boxes about rising places (n,) of an integral image (flat)."""

    def __init__(self, integral_image: NDArray[np.uint32], place: NDArray[np.int32]) -> None:
        self._image = integral_image
        self._first = int(place[0]) if place.size else 0
        self._at = (place - self._first).astype(np.intp)
        self._shared: tuple[bytes, NDArray[np.float32]] | None = None

    def sum(self, offset: NDArray[np.int32]) -> NDArray[np.int32]:
        total, upper_right, lower_left, upper_left = (
            self._image[self._first + corner :].take(self._at) for corner in offset.tolist()
        )
        total -= upper_right
        lower_left -= upper_left
        total -= lower_left
        return total.view(np.int32)

    def shared_sum(self, offset: NDArray[np.int32]) -> NDArray[np.float32]:
        """Sum a box that several stumps have, once."""
        if self._shared is None or self._shared[0] != offset.tobytes():
            self._shared = offset.tobytes(), self.sum(offset).astype(np.float32)
        return self._shared[1]


def _first(windows: Windows) -> Windows:
    n = windows.band_stop[-1]
    return Windows(windows.place[:n], windows.score[:n], windows.band_stop)


def _check_order(windows: Windows) -> None:
    """Check the order of windows.

    The kernel weighs neighbours together, and would read beyond its room for windows out of order.
    """
    n, stops = len(windows.place), windows.band_stop
    if len(windows.score) != n or stops[0] < 0 or (stops[1:] < stops[:-1]).any() or stops[-1] != n:
        raise ValueError(f"bands that end at {stops.tolist()} do not hold {n} windows with {len(windows.score)} scores")
    rises = windows.place[1:] > windows.place[:-1]
    rises[stops[(stops > 0) & (stops < n)] - 1] = True
    if not rises.all():
        raise ValueError(f"places must rise within each band; the one of window {int(np.argmin(rises)) + 1} does not")


def _same_shape(intensity: NDArray[np.float32], mask: NDArray[np.uint8]) -> None:
    if intensity.shape != mask.shape or mask.dtype.itemsize != 1:
        raise ValueError(
            f"mask must hold a byte for each of {intensity.shape} intensities, not {mask.shape} {mask.dtype}"
        )
