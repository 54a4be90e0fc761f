"""Hostile and damaged images: refused or read in bounded memory, whatever their parsers raise, and nothing else opened.

Each case is named after what once hung, filled the memory, read another file or ended in a traceback.
"""

from __future__ import annotations

import os
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from auv_mcm.errors import BadInputError
from auv_mcm.records import Notice, Ping
from auv_mcm.settings.config import Config
from sim_replay.benches.mutant_files import BYTES, SEALED, TEXT
from sim_replay.benches.mutant_seeds import Seed, write_seeds
from sim_replay.benches.mutant_traps import Trap, traps_of
from sim_replay.logs.image_stored import inflate, unpack_bits
from sim_replay.logs.open_log import open_log
from sim_replay.logs.recorded import open_mission
from tests.sim_replay.logs.test_image_log import beside, plane

MEMORY_BYTES = 64 << 20  # of what Python and numpy allocate for a refusal: far below any of the bombs


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Seed]:
    return {seed.name: seed for seed in write_seeds(tmp_path_factory.mktemp("seeds"))}


def copied(seed: Seed, folder: Path) -> Path:
    """A copy of a seed, which may be damaged: the path of its file."""
    for path in seed.folder.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    return folder / seed.file


def read(path: Path) -> None:
    """Read an image to its end."""
    for event in open_log(path, Config()):
        if isinstance(event, Ping) and event.starboard is not None:
            assert len(event.starboard.samples) > 0


# Seconds where allocations are traced; test_strict_yaml.py holds the first two, `auv-mcm bench mutants` all of them.
_SLOW = (
    ("sidecar", "200,000 brackets"),
    ("sidecar", "50,000 keys and the last one twice"),
    ("PNG, 8 bits", "16384 x 16384 pixels"),
    ("npy", "9,000 brackets"),
    ("npy", "9,000 braces"),
    ("sidecar", "a number of 100,000 digits"),
    ("HDF5", "2,000 planes"),
)


def trap_names() -> list[tuple[str, str]]:
    """Traps by seed; those in place of the file itself are tested once, not in every format."""
    folder = Path("nowhere")
    roles = [("TIFF, deflate", "image"), ("PNG, 8 bits", "image"), ("npy", "image"), ("HDF5", "image")]
    roles += [("sidecar", "sidecar")]
    names: list[tuple[str, str]] = []
    for name, role in roles:
        seed = Seed(name, role, folder, "file", ())  # type: ignore[arg-type]
        names += [(name, trap) for trap in traps_of(seed) if (name, trap) not in _SLOW]
    return names


@pytest.mark.parametrize(("name", "trap"), trap_names())
def test_a_trap_is_refused_in_bounded_memory(name: str, trap: str, seeds: dict[str, Seed], tmp_path: Path) -> None:
    seed = seeds[name]
    path = copied(seed, tmp_path)
    set_trap: Trap = traps_of(seed)[trap]
    set_trap.write(path)
    image = path if seed.role == "image" else tmp_path / "base.npy"
    tracemalloc.start()
    try:
        if set_trap.refused:
            with pytest.raises(BadInputError) as refusal:
                read(image)
            assert "\x1b" not in str(refusal.value)
        elif trap != "nothing in it":
            read(image)
        assert tracemalloc.get_traced_memory()[1] < MEMORY_BYTES
    finally:
        tracemalloc.stop()


# --- what parsers raised ---


def with_tag(path: Path, tag: int, form: str, offset: int, value: int) -> None:
    """A TIFF of strips with a number so far behind the beginning of a tag."""
    tifffile.imwrite(path, plane(), compression="zlib", rowsperstrip=10, photometric="minisblack")
    data = bytearray(path.read_bytes())
    (directory,) = struct.unpack_from("<I", data, 4)
    for place in range(directory + 2, directory + 2 + 12 * struct.unpack_from("<H", data, directory)[0], 12):
        if struct.unpack_from("<H", data, place)[0] == tag:
            struct.pack_into(form, data, place + offset, value)
    path.write_bytes(data)


def counts_of_another_image(path: Path) -> None:
    """Offsets of more strips than there are lengths: `zip() argument 2 is longer`."""
    with_tag(path, 279, "<I", 4, 2)  # StripByteCounts


def unknown_compression(path: Path) -> None:
    """A number that names no compression: `'int' object has no attribute 'name'`."""
    with_tag(path, 259, "<H", 8, 54321)  # Compression


def broken_group(path: Path) -> None:
    """A group whose table of names is damaged: `Object visitation failed`."""
    with h5py.File(path, "w", libver="earliest") as file:
        file["one/image"] = plane()
    data = path.read_bytes()
    path.write_bytes(data.replace(b"TREE", b"TRXX").replace(b"SNOD", b"SXXD"))


@pytest.mark.parametrize(
    ("name", "write"), [("a.tif", counts_of_another_image), ("a.tif", unknown_compression), ("a.h5", broken_group)]
)
def test_what_a_parser_raises_names_the_file(name: str, write: Callable[[Path], None], tmp_path: Path) -> None:
    write(tmp_path / name)
    with pytest.raises(BadInputError, match=f"{tmp_path / name}.*(opy|etch|rite)"):
        read(beside(tmp_path / name))


def test_one_bad_image_is_left_out_and_the_other_logs_go_on(tmp_path: Path) -> None:
    for folder in ("bad", "good"):
        (tmp_path / folder).mkdir()
    counts_of_another_image(tmp_path / "bad" / "a.tif")
    tifffile.imwrite(tmp_path / "good" / "a.tif", plane(), photometric="minisblack")
    logs = [beside(tmp_path / folder / "a.tif") for folder in ("bad", "good")]
    events = list(open_mission(logs, Config()).events())
    assert next(event.code for event in events if isinstance(event, Notice)) == "log_unusable"
    assert any(isinstance(event, Ping) for event in events)


# --- decoders stop at what the header states ---


def test_packed_bytes_beyond_the_limit_stay_packed() -> None:
    import zlib

    assert inflate(zlib.compress(bytes(1000)), 10) == bytes(10)
    with pytest.raises(ValueError, match="end after"):
        inflate(zlib.compress(bytes(1000))[:-8], 2000)
    assert unpack_bits(b"\x81\x07" * 1000, 100) == b"\x07" * 100


@given(st.binary(max_size=300), st.integers(0, 400))
def test_packbits_agrees_with_tifffile(packed: bytes, limit: int) -> None:
    from tifffile._imagecodecs import packbits_decode

    assert unpack_bits(packed, limit) == packbits_decode(packed)[:limit]


def test_a_chunk_of_hdf5_that_unpacks_to_more_than_its_size_ends_the_image_there(tmp_path: Path) -> None:
    import zlib

    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        data = file.create_dataset("image", data=plane(), chunks=(20, 64), compression="gzip")
        data.id.write_direct_chunk((20, 0), zlib.compress(bytes(20 * 64 * 2 + 1)))
    notices = [event for event in open_log(beside(path, range="ground"), Config()) if isinstance(event, Notice)]
    assert any("unpacks to more than its 2560 bytes" in notice.text for notice in notices)


def test_hdf5_packed_by_filters_without_a_limit_is_refused_with_the_remedy(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("image", data=plane(), chunks=(20, 64), compression="lzf")
    with pytest.raises(BadInputError, match=r"other filters than deflate.*h5repack -f GZIP"):
        read(beside(path))


@pytest.mark.parametrize("options", [{}, {"shuffle": True, "fletcher32": True}, {"fletcher32": True}])
def test_hdf5_packed_by_deflate_is_read(options: dict[str, bool], tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("image", data=plane(), chunks=(7, 30), compression="gzip", **options)
    pings = [event for event in open_log(beside(path), Config()) if isinstance(event, Ping)]
    read_back = np.sqrt(np.stack([ping.starboard.samples for ping in pings if ping.starboard is not None]))
    assert np.array_equal(read_back.astype(np.uint16), plane())


# --- any damage ---

IMAGES = ("TIFF", "TIFF, deflate", "TIFF, tiles", "BigTIFF", "PNG, 8 bits", "npy", "npy, complex", "HDF5")


@settings(max_examples=250, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    name=st.sampled_from([*IMAGES, "HDF5, complex", "sidecar", "track"]),
    seed=st.integers(0, 1 << 32),
    n_changes=st.integers(1, 4),
)
def test_any_damage_to_any_image_is_read_or_refused(
    name: str, seed: int, n_changes: int, seeds: dict[str, Seed], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = copied(seeds[name], tmp_path_factory.mktemp("damaged"))
    random, data = np.random.default_rng(seed), path.read_bytes()
    changes = [*(BYTES if seeds[name].role == "image" else TEXT).values(), *filter(None, [SEALED.get(path.suffix)])]
    for _ in range(n_changes):
        data = changes[int(random.integers(len(changes)))](data, random)
    path.write_bytes(data)
    image = path if seeds[name].role == "image" else path.with_name("base.npy")
    refusal = ""
    try:
        read(image)
    except BadInputError as error:
        refusal = str(error)
    assert not refusal or os.fspath(path.parent) in refusal
