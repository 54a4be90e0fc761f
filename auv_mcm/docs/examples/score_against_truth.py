"""Score contacts against what really lay on the sea floor.

    python score_against_truth.py MISSION OUT

MISSION is a folder that `auv-mcm simulate` or `auv-mcm augment` wrote: a log, and truth.json beside it. OUT gets the
results of the replay, score.json and froc.png. For surveys with known objects, write a truth.json of your own: the
area in km², and the objects with their kind, place and size; `auv-mcm score` takes it as well.
"""

from __future__ import annotations

import sys
from pathlib import Path

from auv_mcm.settings.config import Config
from sim_replay.replay import replay
from sim_replay.scoring import plot, score_files, score_json, table

GATE_M = 2.0  # a contact farther from an object than this is no call of it


def main(mission: Path, out: Path) -> None:
    """Replay a simulated mission and score its contacts."""
    replay([mission / "mission.xtf"], out, Config())

    # Several missions pool: contacts, truth, contacts, truth ...
    score = score_files([out / "contacts.geojson", mission / "truth.json"], gate_m=GATE_M, threshold=0.5)

    # Rates never come without their intervals: few targets say little.
    at = score.at_threshold
    print(f"{score.n_targets} targets on {score.area_km2:.4f} km²")
    print(
        f"{at.pd.count} of them are called (95 % interval of Pd: {at.pd.low:.2f} to {at.pd.high:.2f}) at p_mine "
        f"{at.threshold:g}"
    )
    for kind in score.kinds:
        print(f"  {kind.kind}: {kind.called.count} of {kind.called.of} called")
    print(table(score))  # all of it, as `auv-mcm score` prints it

    (out / "score.json").write_bytes(score_json(score))
    if score.n_targets:
        plot(score, out / "froc.png")  # Pd over false alarms per km², over all thresholds


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
