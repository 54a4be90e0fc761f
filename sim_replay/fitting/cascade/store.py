"""Store training sets on disk: .npz shards of labelled tiles, and a manifest with contents and digests.

A shard holds the tiles of one background. Arrays of tile k are NNNNN.codes, .valid, .usable (rows of bits) and
.first_return_m; all else is MessagePack in the array `tiles`. It carries no time or place of its making: equal
tiles give equal bytes.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from io import BufferedReader
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple, cast

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from auv_mcm.errors import BadInputError
from auv_mcm.records import Side
from auv_mcm.safe_files import open_regular, read_regular
from auv_mcm.shell.whole_files import write_file
from sim_replay.fitting.cascade.tiles import LabelledTile, Origin, Split, TileObject
from sim_replay.text_tables import json_lines

FORMAT_VERSION: Final = 1  # of the set; a change of its fields raises it
MANIFEST_NAME: Final = "manifest.json"
_EPOCH: Final = (1980, 1, 1, 0, 0, 0)  # the earliest time of a ZIP file, so that equal sets are equal bytes
_HEADER: Final = "tiles"
_REMEDY: Final = "Render the training set anew"


class Shard(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Name one file of a training set.

    n_targets, n_others: objects in the cores of tiles, once per look. by_seabed: those targets by the sea floor they
    lie on.
    """

    file: Annotated[str, Meta(pattern=r"^[\w.-]+\.npz$")]
    split: Split
    background: str
    origin: Origin
    n_tiles: int
    n_targets: int
    n_others: int
    by_seabed: dict[str, int]
    usable_m2: float
    n_bytes: int
    sha256: str


class Manifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Describe a training set.

    made_from: the spec it was rendered from. sha256: of all shards' digests, in order: what a model was trained on.
    """

    format_version: int
    made_from: dict[str, Any]
    shards: tuple[Shard, ...]
    sha256: str


class Packed(NamedTuple):
    """Hold a shard and its bytes, on the way from whoever rendered it to whoever writes it."""

    shard: Shard
    data: bytes


class _TileHeader(msgspec.Struct, frozen=True, kw_only=True):
    n_columns: int
    core_start: int
    core_stop: int
    row_spacing_m: float
    column_spacing_m: float
    side: Side
    objects: tuple[TileObject, ...]
    background: str
    origin: Origin


def pack(tiles: Iterable[LabelledTile], split: Split, background: str, origin: Origin) -> Packed:
    """Pack the shard of a background's tiles; its file is named after the background."""
    buffer = io.BytesIO()
    headers: list[_TileHeader] = []
    by_seabed: Counter[str] = Counter()
    n_others, usable_m2 = 0, 0.0
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for number, tile in enumerate(tiles):
            inside = [
                tile_object for tile_object in tile.objects if tile.core_start <= tile_object.row < tile.core_stop
            ]
            by_seabed.update(tile_object.seabed for tile_object in inside if tile_object.is_target)
            n_others += sum(not tile_object.is_target for tile_object in inside)
            usable_m2 += int(np.count_nonzero(tile.usable)) * tile.row_spacing_m * tile.column_spacing_m
            headers.append(
                _TileHeader(
                    n_columns=tile.codes.shape[1],
                    **{name: getattr(tile, name) for name in _TileHeader.__struct_fields__ if name != "n_columns"},
                )
            )
            _add(archive, f"{number:05}.codes", tile.codes)
            _add(archive, f"{number:05}.valid", np.packbits(tile.valid, axis=1))
            _add(archive, f"{number:05}.usable", np.packbits(tile.usable, axis=1))
            _add(archive, f"{number:05}.first_return_m", tile.first_return_m)
        _add(archive, _HEADER, np.frombuffer(msgspec.msgpack.encode(headers), dtype=np.uint8))
    data = buffer.getvalue()
    shard = Shard(
        file=f"{split}-{''.join(c if c.isalnum() or c in '.-' else '_' for c in background)}.npz",
        split=split,
        background=background,
        origin=origin,
        n_tiles=len(headers),
        n_targets=by_seabed.total(),
        n_others=n_others,
        by_seabed=dict(sorted(by_seabed.items())),
        usable_m2=round(usable_m2, 1),
        n_bytes=len(data),
        sha256=hashlib.sha256(data).hexdigest(),
    )
    return Packed(shard, data)


def write_set(folder: Path, packed: Iterable[Packed], made_from: dict[str, Any]) -> Manifest:
    """Write shards as they come and the manifest last: without it a folder holds no training set."""
    (folder / MANIFEST_NAME).unlink(missing_ok=True)
    shards = []
    for shard, data in packed:
        write_file(folder / shard.file, data)
        shards.append(shard)
    manifest = Manifest(
        format_version=FORMAT_VERSION, made_from=made_from, shards=tuple(shards), sha256=_digest(shards)
    )
    write_file(folder / MANIFEST_NAME, json_lines(manifest, "deterministic"))
    return manifest


def read_manifest(folder: Path) -> Manifest:
    """Read a manifest. Raises BadInputError where there is none, or one that does not agree with itself."""
    path = folder / MANIFEST_NAME
    try:
        manifest = msgspec.json.decode(read_regular(path), type=Manifest)
    except OSError as error:
        raise BadInputError(
            f"{path} cannot be read: {error.strerror}. Name the folder that a training set was rendered into"
        ) from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: {error}. {_REMEDY}") from error
    if manifest.format_version != FORMAT_VERSION:
        raise BadInputError(f"{path} is of format {manifest.format_version}, not {FORMAT_VERSION}. {_REMEDY}")
    if manifest.sha256 != _digest(manifest.shards):
        raise BadInputError(f"{path} was changed after it was written. {_REMEDY}")
    return manifest


def read_shard(folder: Path, shard: Shard) -> Iterator[LabelledTile]:
    """Iterate over the tiles of one shard, each read when its turn comes.

    Raises BadInputError for a file that is missing, cut off or changed, before the first tile is handed out.
    """
    path = folder / shard.file
    try:
        with open_regular(path) as file:
            n_bytes = path.stat().st_size
            if n_bytes != shard.n_bytes:
                raise BadInputError(
                    f"{path} has {n_bytes} bytes, not {shard.n_bytes}: it was cut off or replaced. {_REMEDY}"
                )
            if hashlib.file_digest(cast(BufferedReader, file), "sha256").hexdigest() != shard.sha256:
                raise BadInputError(f"{path} was changed after it was written. {_REMEDY}")
            file.seek(0)
            with zipfile.ZipFile(file) as archive:
                headers = msgspec.msgpack.decode(_take(archive, _HEADER).tobytes(), type=list[_TileHeader])
                for number, header in enumerate(headers):
                    yield _tile(archive, number, header)
    except OSError as error:
        raise BadInputError(f"{path} cannot be read: {error.strerror}. {_REMEDY}") from error
    except (zipfile.BadZipFile, KeyError, ValueError, msgspec.DecodeError) as error:
        raise BadInputError(f"{path} is not a shard of labelled tiles: {error}. {_REMEDY}") from error


def _tile(archive: zipfile.ZipFile, number: int, header: _TileHeader) -> LabelledTile:
    def mask(name: str) -> NDArray[np.bool_]:
        return np.unpackbits(_take(archive, f"{number:05}.{name}"), axis=1, count=header.n_columns).view(np.bool_)

    return LabelledTile(
        codes=_take(archive, f"{number:05}.codes"),
        valid=mask("valid"),
        usable=mask("usable"),
        first_return_m=_take(archive, f"{number:05}.first_return_m"),
        **{name: getattr(header, name) for name in _TileHeader.__struct_fields__ if name != "n_columns"},
    )


def _digest(shards: Sequence[Shard]) -> str:
    return hashlib.sha256(
        "".join(f"{shard.split} {shard.background} {shard.sha256}\n" for shard in shards).encode()
    ).hexdigest()


def _add(archive: zipfile.ZipFile, name: str, values: NDArray[Any]) -> None:
    with archive.open(zipfile.ZipInfo(f"{name}.npy", _EPOCH), "w") as file:
        np.lib.format.write_array(file, np.ascontiguousarray(values), version=(1, 0), allow_pickle=False)


def _take(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    with archive.open(f"{name}.npy") as file:
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False))
