"""Training sets on disk: what is read is what was written, equal tiles give equal bytes, and damage is reported."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from auv_mcm.errors import BadInputError
from sim_replay.fitting.cascade.store import MANIFEST_NAME, Manifest, Packed, pack, read_manifest, read_shard, write_set
from sim_replay.fitting.cascade.tiles import LabelledTile, TileObject


def made_tile(seed: int, *, background: str = "flat/600", shape: tuple[int, int] = (40, 37)) -> LabelledTile:
    random = np.random.Generator(np.random.PCG64(seed))
    valid = random.uniform(size=shape) < 0.9
    usable = valid & (random.uniform(size=shape) < 0.8)
    targets = tuple(
        TileObject(
            row=float(row),
            column=11.5,
            kind="sphere",
            is_target=row != 20,
            seabed="sand",
            ground_range_m=0.7,
            aspect_deg=math.nan,
            length_m=0.8,
            width_m=0.8,
            height_m=math.nan,
        )
        for row in (2, 12, 20, 39)
    )
    return LabelledTile(
        codes=random.integers(0, 16385, shape).astype(np.uint16),
        valid=valid,
        usable=usable,
        core_start=5,
        core_stop=35,
        first_return_m=random.uniform(5.0, 7.0, shape[0]),
        row_spacing_m=0.12,
        column_spacing_m=0.06,
        side="port",
        objects=targets,
        background=background,
        origin="simulated",
    )


def same(one: LabelledTile, other: LabelledTile) -> bool:
    arrays = ("codes", "valid", "usable", "first_return_m")
    plain = [name for name in LabelledTile.__struct_fields__ if name not in arrays]
    return all(
        getattr(one, name).dtype == getattr(other, name).dtype
        and np.array_equal(getattr(one, name), getattr(other, name))
        for name in arrays
    ) and all(repr(getattr(one, name)) == repr(getattr(other, name)) for name in plain)  # NaN is not equal to itself


def written(folder: Path) -> Manifest:
    return write_set(
        folder,
        [
            pack([made_tile(1), made_tile(2)], "train", "flat/600", "simulated"),
            pack([made_tile(3, background="line one.xtf")], "validate", "line one.xtf", "augmented"),
        ],
        {"scenes": ["flat"]},
    )


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    manifest = written(tmp_path)
    assert read_manifest(tmp_path) == manifest
    train, validate = (list(read_shard(tmp_path, shard)) for shard in manifest.shards)
    assert len(train) == 2
    assert all(same(one, made_tile(seed)) for one, seed in zip(train, (1, 2), strict=True))
    assert [tile.background for tile in validate] == ["line one.xtf"]


def test_the_manifest_counts_objects_of_cores_and_usable_floor(tmp_path: Path) -> None:
    shard, _ = written(tmp_path).shards
    assert (shard.n_tiles, shard.n_targets, shard.n_others, shard.by_seabed) == (2, 2, 2, {"sand": 2})
    usable_px = sum(int(made_tile(seed).usable.sum()) for seed in (1, 2))
    assert shard.usable_m2 == pytest.approx(usable_px * 0.12 * 0.06, abs=0.06)


def test_equal_tiles_give_equal_bytes_and_other_ones_another_digest(tmp_path: Path) -> None:
    first, again = tmp_path / "first", tmp_path / "again"
    for folder in (first, again):
        folder.mkdir()
        written(folder)
    assert sorted(path.name for path in first.iterdir()) == [
        MANIFEST_NAME,
        "train-flat_600.npz",
        "validate-line_one.xtf.npz",
    ]
    assert all((again / path.name).read_bytes() == path.read_bytes() for path in first.iterdir())
    other = write_set(again, [pack([made_tile(4)], "train", "flat/600", "simulated")], {})
    assert other.sha256 != read_manifest(first).sha256


def test_numpy_reads_a_shard(tmp_path: Path) -> None:
    written(tmp_path)
    with np.load(tmp_path / "train-flat_600.npz") as arrays:
        assert np.array_equal(arrays["00001.codes"], made_tile(2).codes)


def test_tiles_are_read_when_their_turn_comes(tmp_path: Path) -> None:
    tiles = read_shard(tmp_path, written(tmp_path).shards[0])
    assert same(next(tiles), made_tile(1))
    tiles.close()  # type: ignore[attr-defined]  # leaves no file open, which the tests would report


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


@pytest.mark.parametrize(
    ("damage", "message"), [(cut, "cut off"), (flip, "was changed"), (Path.unlink, "cannot be read")]
)
def test_damaged_shards_are_reported_before_the_first_tile(
    tmp_path: Path, damage: Callable[[Path], None], message: str
) -> None:
    manifest = written(tmp_path)
    damage(tmp_path / "train-flat_600.npz")
    with pytest.raises(BadInputError, match=rf"train-flat_600\.npz .*{message}.*Render the training set anew"):
        next(read_shard(tmp_path, manifest.shards[0]))


def test_files_other_than_shards_are_reported(tmp_path: Path) -> None:
    data = b"nothing of the kind"
    (tmp_path / "other.npz").write_bytes(data)
    shard = msgspec.structs.replace(
        written(tmp_path).shards[0], file="other.npz", n_bytes=len(data), sha256=hashlib.sha256(data).hexdigest()
    )
    with pytest.raises(BadInputError, match="is not a shard of labelled tiles"):
        next(read_shard(tmp_path, shard))


def test_a_manifest_that_lost_a_shard_is_reported(tmp_path: Path) -> None:
    manifest = written(tmp_path)
    (tmp_path / MANIFEST_NAME).write_bytes(
        msgspec.json.encode(msgspec.structs.replace(manifest, shards=manifest.shards[:1]))
    )
    with pytest.raises(BadInputError, match="was changed after"):
        read_manifest(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "cannot be read"),
        ("{", "truncated"),
        ('{"format_version": 1}', "made_from"),
        ('{"format_version": 2, "made_from": {}, "shards": [], "sha256": ""}', "is of format 2, not 1"),
        ('{"format_version": 1, "made_from": {}, "shards": [], "sha256": ""}', "was changed"),
    ],
)
def test_a_folder_without_a_sound_manifest_is_refused(tmp_path: Path, text: str | None, message: str) -> None:
    if text is not None:
        (tmp_path / MANIFEST_NAME).write_text(text)
    with pytest.raises(BadInputError, match=f"{MANIFEST_NAME}.*{message}"):
        read_manifest(tmp_path)


def test_a_set_that_was_not_finished_has_no_manifest(tmp_path: Path) -> None:
    written(tmp_path)

    def packed() -> Iterator[Packed]:
        yield pack([made_tile(1)], "train", "flat/600", "simulated")
        raise BadInputError("out of tiles")

    with pytest.raises(BadInputError, match="out of tiles"):
        write_set(tmp_path, packed(), {})
    assert not (tmp_path / MANIFEST_NAME).exists()
