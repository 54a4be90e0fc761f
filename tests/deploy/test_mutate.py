"""Changes that a mutation run makes: one each, none in types, and a test notices those of a constant."""

from __future__ import annotations

from pathlib import Path

from deploy.mutate import ROOT, changes_of, compiled, files_for, sample

SOURCE = '''"""A module."""
LIMIT: float = 2.0
def keeps(x: float) -> bool:
    return x + 1.0 < LIMIT and not x == 0.0
'''


def test_each_change_alters_one_place_and_no_annotation(tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text(SOURCE)
    found = [(change.before, change.after) for change in changes_of(path)]
    assert ("2.0", "3.0") in found
    assert ("x + 1.0 < LIMIT", "x + 1.0 <= LIMIT") in found
    assert ("x + 1.0", "x - 1.0") in found
    assert ("not x == 0.0", "x == 0.0") in found
    for change in changes_of(path):
        values: dict[str, object] = {}
        exec(compiled(change), values)
        assert callable(values["keeps"])
    assert len(found) == len(set(found))


def test_a_sample_takes_turns_and_finds_tests_for_each_change() -> None:
    places = ("auv_mcm/clearance/residual.py", "drivers/vehicle/guard.py")
    drawn = sample(places, 4, 45)
    assert [str(change.path.relative_to(ROOT)) for change in drawn] == [*places, *places]
    first = [Path(files_for(change.path, whole=False)[0]).name for change in drawn[:2]]
    assert first == ["test_residual.py", "test_guard.py"]
