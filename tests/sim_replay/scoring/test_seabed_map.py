"""The coded sea floor map: what goes in comes out, lies where it should, and damage is named."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as some
from msgspec import structs
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.geometry.geodesy import LocalFrame
from sim_replay.scoring.seabed_map import SeabedMap, decode, encode, types_at

TYPES = ("sand", "mud", "rock")
CELLS = np.array([[0, 0, 0, -1], [1, 1, 2, -1]])


def coded(cells: NDArray[np.integer], cell_m: float = 1.0) -> SeabedMap:
    return encode(cells, types=TYPES, cell_m=cell_m, latitude_deg=43.1, longitude_deg=5.9)


def decoded_sign_by_sign(rows: tuple[str, ...]) -> list[list[int]]:
    """The obvious decoder."""
    cells = []
    for text in rows:
        row, digits = [], ""
        for sign in text:
            if sign.isdigit():
                digits += sign
            else:
                row += [-1 if sign == "." else ord(sign) - ord("a")] * int(digits)
                digits = ""
        cells.append(row)
    return cells


def test_rows_are_runs_from_south_to_north() -> None:
    assert coded(CELLS).rows == ("3a1.", "2b1c1.")


@given(cells=some.arrays(np.int64, st.tuples(st.integers(0, 6), st.integers(0, 30)), elements=st.integers(-1, 2)))
def test_decoding_gives_back_what_was_encoded(cells: NDArray[np.int64]) -> None:
    seabed = coded(cells)
    assert decode(seabed).tolist() == cells.tolist() == decoded_sign_by_sign(seabed.rows)
    assert msgspec.json.decode(msgspec.json.encode(seabed), type=SeabedMap) == seabed


def test_split_runs_are_understood() -> None:
    assert decode(structs.replace(coded(CELLS), rows=("1a2a0b1.", "2b1c1."))).tolist() == CELLS.tolist()


def test_position_finds_its_cell_from_the_south_west_corner() -> None:
    seabed = coded(CELLS, cell_m=2.5)
    east_m, north_m = np.meshgrid(np.arange(-1.25, 12.5, 2.5), np.arange(-1.25, 7.5, 2.5))
    frame = LocalFrame(latitude_deg=43.1, longitude_deg=5.9)
    latitude, longitude, _ = frame.to_geodetic(np.stack([east_m, north_m, np.zeros_like(east_m)], axis=-1))
    expected = np.full(east_m.shape, -1)
    expected[1:3, 1:5] = CELLS
    assert types_at(seabed, decode(seabed), latitude, longitude).tolist() == expected.tolist()
    assert types_at(seabed, decode(seabed), np.nan, 5.9).tolist() == -1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rows": ("3a1.",)}, "1 rows, but n_rows is 2"),
        ({"rows": ("3a1.", "2b1d1.")}, r"rows\[1\]: letter 'd' has no type"),
        ({"rows": ("3a1.", "2b1c")}, r"rows\[1\]: runs of 3 cells, but n_columns is 4"),
        ({"rows": ("3a1.", "2b-1c1.")}, r"rows\[1\]: not a repeated"),
        ({"rows": ("aaa.", "2b1c1.")}, r"rows\[0\]: not a repeated"),
        ({"rows": ("3a1.\n", "2b1c1.")}, r"rows\[0\]: not a repeated"),
        ({"n_columns": 1_000_000_000}, "cells are more than"),
    ],
)
def test_damaged_map_names_the_row(change: dict[str, object], message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        decode(structs.replace(coded(CELLS), **change))


def test_what_has_no_letter_is_not_encoded() -> None:
    with pytest.raises(ValueError, match="27 sea floor types"):
        encode(CELLS, types=["sand"] * 27, cell_m=1.0, latitude_deg=0.0, longitude_deg=0.0)
    for strange in (3, -2):
        with pytest.raises(ValueError, match="but there are 3 types"):
            coded(np.array([[strange]]))
