"""`auv-mcm bench all`, as a person runs it: errors within limits, comparison, page. No time is judged."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from auv_mcm.cli import main
from sim_replay.benches.every_stage import bench, stages
from sim_replay.benches.every_stage.bench import EveryStageResults, moved_since, stage_history
from sim_replay.benches.every_stage.rows import Alternative, Cost, Other, Row, StageRow, measured
from sim_replay.benches.every_stage.sea_floor import share_wrong
from sim_replay.benches.every_stage.shadow_ends import shadow_errors_m
from sim_replay.benches.run_time.measure import BenchMachine


def test_every_stage_errs_no_more_than_its_limit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same through all outputs; what was not measured is said."""
    written = tmp_path / "found.json"
    assert main(["bench", "all", "--quick", "--json", str(written)]) == 0
    found = json.loads(written.read_text())
    first_words = {name.partition("-")[0] for name in stages.STAGES}
    assert {row["stage"].split()[0] for row in found["rows"]} == first_words
    assert found["machine"]["versions"]["numpy"] == np.__version__
    printed = capsys.readouterr().out
    for row in found["rows"]:
        if row["alternative"] is not None and row["alternative"]["cost"] is None:
            assert f"not measured: {row['alternative']['missing']}" in printed
    assert main(["bench", "all", "--quick", "--stages", "waterfall", "--compare", str(written)]) == 0
    assert "error" not in capsys.readouterr().out.partition("moved beyond noise:")[2]


def test_a_stage_that_errs_more_than_its_limit_ends_with_code_5(monkeypatch: pytest.MonkeyPatch) -> None:
    worse = Row("made here", "one", lambda: 2.0, float, "m", 1.0)
    monkeypatch.setattr(bench, "STAGES", {"made here": lambda n: [worse]})
    assert main(["bench", "all", "--quick"]) == 5


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--stages", "nothing"], "there is no 'nothing'"),
        (["--compare", "nowhere.json"], "cannot be read"),
        (["--compare", "nowhere.json", "--stress"], "leave one out"),
    ],
)
def test_what_cannot_be_measured_is_refused(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "all", *arguments]) == 2
    assert words in capsys.readouterr().err


def row(*, error: float = 1.0, limit: float | None = None, times_ms: tuple[float, ...] = (9.0, 10.0, 11.0)) -> StageRow:
    other = Alternative(name="other", cost=Cost((100.0,)), error=3.0)
    return StageRow(
        stage="made here", setting="one", cost=Cost(times_ms), error=error, unit="m", limit=limit, alternative=other
    )


def results(*rows: StageRow) -> EveryStageResults:
    machine = msgspec.convert(
        {"processor": "", "cores": 1, "kernels": "c", "versions": {}, "date": "", "load": (0.0, 0.0)}, BenchMachine
    )
    return EveryStageResults(machine=machine, n_inputs=1, repeat=3, stages=("made",), rows=rows)


@pytest.mark.parametrize(
    ("now", "words"),
    [
        (row(), ""),
        (row(times_ms=(10.5, 11.0, 13.0)), ""),  # the ranges overlap
        (row(times_ms=(20.0, 21.0, 22.0)), "time 0.1 -> 0.21 of the alternative (+110%)"),
        (row(error=1.5), "error 1 -> 1.5 m"),
        (msgspec.structs.replace(row(), setting="two"), "made here, two: new"),
    ],
)
def test_a_comparison_says_what_moved_and_nothing_else(now: StageRow, words: str) -> None:
    said = "\n".join(moved_since(results(row()), results(now)))
    assert (words in said) if words else said == ""
    both = results(row(), msgspec.structs.replace(row(), setting="gone"))
    assert moved_since(both, results(row())) == ["made here, gone: no longer measured"]


def test_a_history_has_a_row_per_stage_and_a_dash_where_one_was_not_measured() -> None:
    other = msgspec.structs.replace(row(), stage="another")
    (first, *cells), (second, *dashed) = stage_history([results(row()), results(row(), other)])
    assert (first, second) == ("made here", "another")
    assert cells == ["time 0.1 of other; error 1, its 3: m"] * 2
    assert dashed == ["-", cells[0]]


def test_the_share_wrong_weighs_all_kinds_alike() -> None:
    shares = np.eye(4, dtype=np.float32)[[0, 0, 0, 1]]
    assert share_wrong(np.array([0, 0, 0, 3]), shares) == 0.5


def test_shadows_end_within_a_cell_of_where_they_should() -> None:
    assert float(np.sqrt(np.mean(shadow_errors_m(0.1) ** 2))) < 0.06


def test_a_work_of_several_rows_is_done_once_and_judged_by_each() -> None:
    done: list[str] = []

    def work() -> float:
        done.append("ours")
        return 2.0

    def other() -> float:
        done.append("theirs")
        return 3.0

    rows = [
        Row("made here", "one", work, lambda found: found - 1.0, "m", 1.0, Other("other", other), per=2.0),
        Row("made here", "one", work, lambda found: 2.0 * found, "of it", 1.0, Other("lacking", other, missing="gone")),
    ]
    first, second = measured(rows, 3)
    assert done == ["ours", "theirs"] * 3
    assert (first.error, first.holds, second.error, second.holds) == (1.0, True, 4.0, False)
    assert first.alternative is not None
    assert first.alternative.error == 2.0
    assert first.cost.ms == pytest.approx(0.5 * second.cost.ms)
    assert second.alternative == Alternative(name="lacking", missing="gone")
