"""Text that others wrote neither moves a cursor nor passes for a line of the log, wherever it is shown."""

from __future__ import annotations

import json
import logging
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_mcm.clean_text import CleanFormatter, clean, clean_json, clean_lines, is_clean
from auv_mcm.cli import main
from auv_mcm.errors import BadInputError
from auv_mcm.records import Notice
from auv_mcm.shell.whole_files import write_json

ROOT = Path(__file__).resolve().parents[2]
HOSTILE = "a\x1b[2J\r\nb\x07\x7f\x9b31m\u202egnp.exe\u2066\u2028\ufeff\U000e0041\udc80\ufffe\x00"


def test_control_characters_are_written_out_and_everything_else_stays() -> None:
    assert clean("a\x1b[2J\nb\x9b\u202e\udc80") == r"a\x1b[2J\nb\x9b\u202e\udc80"
    # the fifth has a joiner that its script needs
    for plain in ("", "Übung 3, 0.5 m², ± 2 °", "日本語", "نسخهٔ می‌خواهم", r"C:\new"):
        assert clean(plain) == plain


@given(st.text(st.characters()))
def test_no_text_stays_unsafe(text: str) -> None:
    assert is_clean(clean(text))
    assert all(sign.isprintable() or sign not in "\x00\t\n\r\x1b\x7f\x85\x9b\u2028\u202e" for sign in clean(text))
    clean(text).encode()
    ElementTree.fromstring(f"<a>{clean(text).replace('&', '').replace('<', '')}</a>")


def test_a_device_cannot_forge_a_line_with_the_text_of_a_notice() -> None:
    notice = Notice(code="sonar_refused", text=f"refused: {HOSTILE}", place=HOSTILE)
    assert is_clean(notice.text)
    assert is_clean(notice.place)
    assert r"\x1b[2J\r\nb" in notice.text


def test_a_log_record_is_one_line_and_its_traceback_is_indented() -> None:
    try:
        raise ValueError("x\n2026-01-01T00:00:00.000Z INFO ready\x1b[2J")
    except ValueError:
        record = logging.LogRecord(
            "x", logging.ERROR, __file__, 1, "it said %s", ("a\n2026 INFO ready\x1b",), sys.exc_info()
        )
    first, *others = CleanFormatter("%(levelname)s %(message)s").format(record).split("\n")
    assert first == r"ERROR it said a\n2026 INFO ready\x1b"
    assert others
    assert all(line.startswith("  ") and is_clean(line) for line in others)


def test_the_log_of_the_service_is_clean() -> None:
    program = (
        "import logging, pathlib\n"
        "from auv_mcm.shell import serve as door\n"
        "from auv_mcm.commands.run import run_service\n"
        "from auv_mcm.settings.config import Config\n"
        "def serve(config, *, clock=None):\n"
        "    logging.getLogger('drivers').info('it said %s', 'x\\x1b[2J\\n2026 INFO ready')\n"
        "    return pathlib.Path('out')\n"
        "door.serve = serve\n"
        "run_service(Config())\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert re.fullmatch(
        r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z INFO it said x\\x1b\[2J\\n2026 INFO ready\n", done.stderr
    )


def test_lines_of_an_error_stay_lines_and_none_of_them_begins_at_the_margin() -> None:
    assert clean_lines("auv-mcm: none:\n  one\nauv-mcm: two\x1b") == "auv-mcm: none:\n  one\n  auv-mcm: two\\x1b"


def test_a_file_name_with_control_characters_is_refused_without_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = "no\x1b[2J\nauv-mcm: all good\udc80.xtf"
    assert main(["replay", str(tmp_path / name), "--out", str(tmp_path / "out")]) == BadInputError.exit_code
    printed = capsys.readouterr().err
    assert r"no\x1b[2J" in printed
    assert r"\udc80.xtf does not exist" in printed
    assert all(is_clean(line) for line in printed.splitlines())
    assert not [line for line in printed.splitlines()[1:] if line.startswith("auv-mcm:")]


def test_json_for_scripts_holds_the_same_values_without_a_raw_control_character(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"place": HOSTILE, "é": ["±"]})
    text = (tmp_path / "a.json").read_text("utf-8")
    assert all(map(is_clean, text.splitlines()))
    assert json.loads(text) == {"place": HOSTILE.replace("\udc80", "?"), "é": ["±"]}
    assert clean_json('{\n "a": "\U000e0041"\n}') == '{\n "a": "\\udb40\\udc41"\n}'
