"""Numbers and files on a bench's command line."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from auv_mcm.cli import main
from sim_replay.arguments import count, new_file


@pytest.mark.parametrize("text", ["0", "-1", "1.5", "1000001", "", "many", "²"])
def test_what_is_no_count_is_rejected(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="whole number from 1"):
        count(text)


def test_a_file_is_taken_where_its_folder_is_there(tmp_path: Path) -> None:
    assert count("3") == 3
    assert new_file(str(tmp_path / "new.json")) == tmp_path / "new.json"
    assert new_file("new.json") == Path("new.json")
    with pytest.raises(argparse.ArgumentTypeError, match=r"there is no folder .*missing\. Make it first"):
        new_file(str(tmp_path / "missing" / "new.json"))


@pytest.mark.parametrize(
    ("bench", "option"), [("chain", "--json"), ("all", "--json"), ("views", "--json"), ("seabed", "--json")]
)
def test_a_missing_folder_is_reported_before_anything_is_measured(
    bench: str, option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", bench, option, str(tmp_path / "nowhere" / "file.png")])
    assert ended.value.code == 2
    assert f"{option}: " in capsys.readouterr().err
