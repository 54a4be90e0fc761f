"""The bench explains itself."""

from __future__ import annotations

import pytest

from auv_mcm.cli import main


def test_the_bench_explains_itself(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", "adapt", "--help"])
    assert ended.value.code == 0
    assert "auv-mcm bench adapt" in capsys.readouterr().out
