"""The benches, as a person runs them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from auv_mcm.cli import main
from sim_replay.commands.bench import BENCHES, FINISHED

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("bench", BENCHES)
def test_every_bench_that_is_offered_explains_itself(bench: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", bench, "--help"])
    assert ended.value.code == 0
    assert f"auv-mcm bench {bench}" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments", [["chain", "--repeat", "0"], ["domains", "--seeds", "-3"], ["seabed", "--seeds", "many"]]
)
def test_numbers_that_nothing_can_be_measured_with_are_refused(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", *arguments])
    assert ended.value.code == 2
    assert f"'{arguments[-1]}' is no" in capsys.readouterr().err


@pytest.mark.parametrize(("tag", "bench"), [(tag, name) for (tag, _), names in FINISHED.items() for name in names])
def test_a_finished_bench_says_where_it_is(tag: str, bench: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", bench, "--markdown"]) == 2
    assert f"'{bench}' is finished, and kept in the sources at {tag}" in capsys.readouterr().err


def test_a_bench_loads_no_other_ones_modules() -> None:
    code = (
        "import sys; from auv_mcm.cli import main\n"
        "try: main(['bench', 'mutants', '--help'])\n"
        "except SystemExit: print(*(name for name in sys.modules if name.startswith('sim_replay.benches')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    loaded = set(done.stdout.split())
    assert {name for name, (module, _) in BENCHES.items() if f"sim_replay.{module}" in loaded} == {"mutants"}
