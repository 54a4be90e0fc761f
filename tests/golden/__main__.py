"""Compare the answers of this checkout with those stored, in words; `--update` stores them.

    python -m tests.golden [NAME...] [--update]

NAME: a scene, a recorded line, `help` or `scenarios`; all without one. The exit code is 1 if anything moved.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

from auv_mcm import kernels
from tests.golden.answers import (
    LINES,
    Answer,
    help_answer,
    line_answer,
    read_stored,
    scenario_answer,
    scene_answer,
    scene_names,
    store,
)
from tests.golden.differences import mission_differences, text_differences

Compare = Callable[[Answer, Answer], list[str]]


def kinds() -> dict[str, tuple[str, Callable[[], Answer], Compare]]:
    """Map each name to the name it is stored by, what computes it, and what compares two of it."""
    found: dict[str, tuple[str, Callable[[], Answer], Compare]] = {
        "help": ("help", help_answer, text_differences),
        "scenarios": ("scenarios", scenario_answer, text_differences),
    }
    for name in scene_names():
        found[name] = (f"scene-{name}", lambda name=name: scene_answer(name), mission_differences)  # type: ignore[misc]
    for path in sorted(LINES.glob("*.xtf")):
        found[path.stem] = (f"line-{path.stem}", lambda path=path: line_answer(path), mission_differences)  # type: ignore[misc]
    return found


def main() -> int:
    """Run the command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=(__doc__ or "").splitlines()[0])
    known = kinds()
    parser.add_argument("names", metavar="NAME", nargs="*", help=f"of {', '.join(known)} (default all)")
    parser.add_argument("--update", action="store_true", help="store the answers")
    chosen = parser.parse_args()
    if unknown := [name for name in chosen.names if name not in known]:
        parser.error(f"there is no answer '{unknown[0]}': give one of {', '.join(known)}")
    if kernels.backend() != "c":
        parser.error("stored answers are those of the C kernels: build them with 'setup.py build_ext --inplace'")
    if not LINES.is_dir():
        print(f"{LINES} is not there: recorded lines are left out")
    n_moved = 0
    for name in chosen.names or known:
        place, compute, compare = known[name]
        old, new = read_stored(place), compute()
        if old is None:
            print(f"{name}: new")
        elif old == new:
            print(f"{name}: the same")
            continue
        else:
            words = compare(old, new)
            if old.get("platform") != new.get("platform"):
                words.append(f"platform: {old.get('platform')} -> {new.get('platform')}")
            print(f"{name}:\n" + "\n".join(f"  {line}" for line in words or ["changed by less than is put in words"]))
        n_moved += 1
        if chosen.update:
            store(place, new)
    print(f"{n_moved} moved" + (", stored" if chosen.update and n_moved else ""))
    return 0 if chosen.update or not n_moved else 1


if __name__ == "__main__":
    sys.exit(main())
