"""The bench explains itself and refuses files that it could not write, before it flies anything."""

from __future__ import annotations

from pathlib import Path

import pytest

from auv_mcm.cli import main


def test_the_bench_explains_itself(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", "adapt", "--help"])
    assert ended.value.code == 0
    assert "auv-mcm bench adapt" in capsys.readouterr().out


@pytest.mark.parametrize("option", ["--json", "--picture"])
def test_a_missing_folder_is_reported_before_anything_is_flown(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "adapt", option, str(tmp_path / "nowhere" / "file")]) == 2
    assert f"{option} " in capsys.readouterr().err
