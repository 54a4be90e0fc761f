"""Files that are no readable log: named by what they are, with what to do."""

from __future__ import annotations

import gzip
import io
import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from auv_mcm.errors import BadInputError
from auv_mcm.settings.config import Config
from sim_replay.logs.foreign_formats import FOREIGN
from sim_replay.logs.open_log import FORMATS, find_format, open_log

WHOLE_LOG = bytes(range(256)) * 40


def zipped(*names: str) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name in names:
            archive.writestr(name, WHOLE_LOG)
    return file.getvalue()


def segy() -> bytes:
    return b"C 1 CLIENT".ljust(3200).decode().encode("cp037") + struct.pack(">3i12h", 1, 1, 1, *(1,) * 12) + bytes(400)


CASES: dict[str, tuple[str, bytes, str]] = {
    "gzip": ("log.xtf", gzip.compress(WHOLE_LOG), r"compressed \(gzip\). Unpack it"),
    "zip": ("log.xtf", zipped("log.xtf"), r"compressed \(zip\). Unpack it"),
    "docx": ("log.jsf", zipped("[Content_Types].xml", "word/document.xml"), "a Word document"),
    "logdoc": ("a.logdoc", b"\0\1\2" * 50, r"StarFish log \(.logdoc\). Export it as XTF"),
    "html": ("log.xtf", b"\n <!DOCTYPE html><html>404</html>", r"a web page \(HTML\).*direct link"),
    "git lfs": (
        "log.xtf",
        b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n",
        "a Git LFS pointer.*git lfs pull",
    ),
    "git-annex": ("log.xtf", b"/annex/objects/SHA256E-s1--00.xtf\n", "git annex get"),
    "pdf": ("log", b"%PDF-1.7\n", "a PDF document"),
    "s7k": ("log", struct.pack("<HHI", 5, 60, 0x0000FFFF) + bytes(100), "SeaBat 7k.*side scan as XTF"),
    "all": ("log", struct.pack("<IBB", 200, 2, 0x49) + bytes(200), r"Kongsberg log \(.all"),
    "kmall": ("log", struct.pack("<I", 200) + b"#IIP" + bytes(200), r"Kongsberg log \(.kmall"),
    "gsf": ("log", struct.pack(">II", 12, 12) + b"GSF-v03.09", "Generic Sensor Format"),
    "seg-y": ("log", segy(), "SEG-Y file"),
    "sdfx": ("log.sdfx", bytes(64), r"Klein log \(.sdfx\). Export it as XTF with Klein"),
    "mstiff": ("log", b"MSTL" + bytes(100), "Marine Sonic log"),
    "slg": ("log", struct.pack("<HHHH", 1, 0, 1970, 0) + bytes(100), "Lowrance log .SLG.*SL2 or SL3"),
    "rsd": ("log", b"\x06\x04\x86\xda\xe9\xb7" + bytes(100), "Garmin log"),
    "dvs": ("log", struct.pack("<IffiBB", 1, 0.05, 10.0, 1000, 1, 1) + bytes(100), "DeepVision log"),
    "bag": ("log", b"\x89HDF\r\n\x1a\n" + bytes(800) + b"BAG_root", "bathymetric grid"),
    "lsf": ("log.lsf", b"\0\1\2" * 50, "sonar log"),
    "sqlite": ("log", b"SQLite format 3\0" + bytes(100), "SQLite"),
}


@pytest.mark.parametrize("name", CASES)
def test_a_foreign_file_is_named_with_what_to_do(name: str, tmp_path: Path) -> None:
    file, content, words = CASES[name]
    path = tmp_path / file
    path.write_bytes(content)
    with pytest.raises(BadInputError, match=words) as caught:
        open_log(path, Config())
    assert str(path) in str(caught.value)


def test_every_row_can_be_found_by_bytes_or_by_name() -> None:
    for row in FOREIGN:
        assert row.title
        assert row.remedy
        assert row.suffixes or not row.begins(b"")


@pytest.mark.parametrize("n_bytes", [0, 1, 3, 8, 64, 500])
def test_short_and_empty_beginnings_are_nothing_that_raises(n_bytes: int) -> None:
    for byte in (0, 1, 0x42, 0xFF):
        for row in FOREIGN:
            assert row.begins(bytes([byte]) * n_bytes) in (True, False)
        for form in FORMATS:
            assert form.recognises(bytes([byte]) * n_bytes) >= 0


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_a_format_claims_nothing_of_another_format(form: object) -> None:
    own = {"xtf": b"\x7b" + bytes(1023), "session": b"\x89MCAP0\r\n", "tiff": b"II*\0", "png": b"\x89PNG"}
    own |= {"npy": b"\x93NUMPY", "hdf5": b"\x89HDF\r\n\x1a\n", "svlog": b"BR", "jsf": b"\x01\x16"}
    own |= {"sdf": b"\xff\xff\xff\xff" + bytes(8), "lowrance": struct.pack("<HHHH", 2, 0, 3200, 0)}
    own |= {"humminbird": b"\xc0\xde\xab\x21"}
    claims: Callable[[bytes], int] = form.recognises  # type: ignore[attr-defined]
    for name, head in own.items():
        assert bool(claims(head)) == (name == form.name)  # type: ignore[attr-defined]


def test_the_name_of_a_readable_log_does_not_count(tmp_path: Path) -> None:
    path = tmp_path / "log.sdf"
    path.write_bytes(b"\x7b" + bytes(1023))
    assert find_format(path).name == "xtf"


def test_the_page_of_formats_has_a_row_for_every_format_that_is_read_or_named() -> None:
    page = (Path(__file__).parents[3] / "auv_mcm/docs/reference/interoperability.md").read_text("utf-8").lower()
    lines = page[page.index("## formats") : page.index("## sides and channels")].splitlines()

    def words_of(outcome: str) -> set[str]:
        return {word for line in lines if f"| {outcome}" in line for word in re.findall(r"[\w-]+", line)}

    assert {{"session": "mcap"}.get(one.name, one.name) for one in FORMATS} <= words_of("read")
    refused = words_of("refused")
    for row in FOREIGN:
        names = re.findall(r"\w+-\w+|\b\w*[A-Z]\w*\b|(?<=\()[\w-]+", row.title)
        names += [suffix[1:] for suffix in row.suffixes]
        assert {name.lower() for name in names} & refused, row.title
