"""How pieces of recorded lines become collages, and what is counted on them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np

from auv_mcm.settings.config import Config
from sim_replay.commands.bench import BENCHES
from sim_replay.fitting.cascade.classical.chips import N_COLUMNS, N_ROWS
from sim_replay.fitting.cascade.classical.train_classical import ChipSamples
from sim_replay.fitting.cascade.tiles import LabelledTile, TileObject
from sim_replay.studies.families import models_of
from sim_replay.studies.floor_collage import (
    COLLAGE,
    Piece,
    PieceTask,
    collages_of,
    cut,
    draw,
    joined,
    lines_table,
    pieces_of,
    table,
)
from sim_replay.studies.paper_candidates import ImageCandidates, tile_candidates
from sim_replay.studies.paper_scenes import TYPES, in_one_tile

ROW_M, COLUMN_M = 0.12, 0.06


def _object(kind: str, row: float) -> TileObject:
    return TileObject(
        row=row,
        column=200.0,
        kind=kind,
        is_target=kind != "box",
        seabed="unknown",
        ground_range_m=12.0,
        aspect_deg=0.0,
        length_m=1.0,
        width_m=1.0,
        height_m=0.4,
    )


def _tile(line: str, *objects: TileObject, n_rows: int = 400, n_columns: int = 300) -> LabelledTile:
    everywhere = np.ones((n_rows, n_columns), dtype=np.bool_)
    return LabelledTile(
        codes=np.random.Generator(np.random.PCG64(2)).integers(1, 2048, everywhere.shape).astype(np.uint16),
        valid=everywhere,
        usable=everywhere,
        core_start=0,
        core_stop=n_rows,
        first_return_m=np.linspace(4.0, 6.0, n_rows),
        row_spacing_m=ROW_M,
        column_spacing_m=COLUMN_M,
        side="port",
        objects=objects,
        background=f"{line}.xtf",
        origin="augmented",
    )


def _pieces(line: str, n_columns: int = 300) -> list[Piece]:
    return [
        piece
        for kind, n in COLLAGE.items()
        for _ in range(n)
        for piece in cut(_tile(line, _object(kind, 200.0), n_columns=n_columns))
    ]


def test_a_piece_holds_its_object_in_its_middle_and_no_other() -> None:
    (piece,) = cut(_tile("river", _object("wedge", 200.0), _object("box", 390.0)))
    assert (piece.line, piece.kind) == ("river", "wedge")
    n_rows = piece.tile.codes.shape[0]
    assert abs(piece.tile.objects[0].row - 0.5 * n_rows) < 1.0
    assert piece.tile.core_stop == len(piece.tile.first_return_m) == n_rows
    assert list(cut(_tile("river", _object("wedge", 200.0), _object("box", 220.0)))) == []


def test_collages_have_the_objects_of_the_paper_and_mix_lines() -> None:
    collages = collages_of([*_pieces("river"), *_pieces("wreck")])
    assert len(collages) == 2
    for collage in collages:
        assert {kind: [piece.kind for piece in collage].count(kind) for kind in COLLAGE} == COLLAGE
        assert {piece.line for piece in collage} == {"river", "wreck"}
    assert collages_of([piece for piece in _pieces("river") if piece.kind != "box"]) == []


def test_ranges_and_altitudes_stay_those_of_the_recording() -> None:
    narrow, wide = _pieces("river", 200)[0], _pieces("wreck", 300)[1]
    tile = joined([narrow, wide])
    n_rows = narrow.tile.codes.shape[0]
    assert np.array_equal(tile.codes[:n_rows, :200], narrow.tile.codes)
    assert np.array_equal(tile.codes[n_rows:], wide.tile.codes)
    assert not tile.valid[:n_rows, 200:].any()
    assert np.array_equal(tile.first_return_m, np.concatenate([narrow.tile.first_return_m, wide.tile.first_return_m]))
    assert [one.row for one in tile.objects] == [narrow.tile.objects[0].row, wide.tile.objects[0].row + n_rows]


def test_collages_are_judged_by_every_feature_set_and_drawn() -> None:
    random = np.random.Generator(np.random.PCG64(3))
    kind = (*TYPES.values(), "", "", "") * 4
    chips = random.normal(0.0, 1.0, (len(kind), N_ROWS, N_COLUMNS)).astype(np.float32)
    models = models_of(ChipSamples(chips, kind, ("flat/600",) * len(kind), np.ones(len(kind))), tuple(TYPES))
    config = in_one_tile(Config())
    (collage,) = collages_of(_pieces("river"))
    tile = joined(collage)
    header, rows = table([ImageCandidates("collage", (tile_candidates(tile, config),))], models)
    assert len(rows) == len(models) + 1
    assert all(len(row) == len(header) for row in rows)
    picture = draw(collage, models["all six"], config)
    assert picture.ndim == 3
    assert picture.shape[1] == round(tile.codes.shape[0] * ROW_M / 0.08)


def test_pieces_of_a_recorded_line_hold_what_was_embedded(shared_data: Callable[[str], Path]) -> None:
    pieces = pieces_of(PieceTask(shared_data("sidescan/scotsman-iver2.xtf"), 9100))
    assert pieces
    assert {piece.kind for piece in pieces} <= set(COLLAGE)
    assert {piece.line for piece in pieces} == {"scotsman-iver2"}


def test_the_studies_of_the_paper_are_benches() -> None:
    assert {"families", "collage", "shadow", "fusion"} <= set(BENCHES)


def test_pieces_without_any_candidate_are_judged_too() -> None:
    kind = ("wedge", "") * 10
    chips = np.random.Generator(np.random.PCG64(3)).normal(0.0, 1.0, (len(kind), N_ROWS, N_COLUMNS))
    samples = ChipSamples(chips.astype(np.float32), kind, ("flat/600",) * len(kind), np.ones(len(kind)))
    model = models_of(samples, tuple(TYPES))["all six"]
    piece = next(cut(_tile("river", _object("wedge", 200.0))))
    even = msgspec.structs.replace(piece.tile, codes=np.full_like(piece.tile.codes, 1024))
    image = ImageCandidates("river", (tile_candidates(even, Config()),))
    assert not len(image.tiles[0].rows)
    header, rows = lines_table({"river": [image]}, model)
    assert dict(zip(header, rows[0], strict=True))["B"].startswith("0.00")
