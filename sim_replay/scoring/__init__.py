"""Score contacts against truth."""

from sim_replay.scoring.inputs import (
    ReportedContact,
    ScoredMission,
    Truth,
    TruthObject,
    parse_contacts,
    parse_truth,
    read_contacts,
    read_truth,
)
from sim_replay.scoring.plot import plot
from sim_replay.scoring.score import Score, score_files, score_json, score_missions
from sim_replay.scoring.table import sentence, table

__all__ = [
    "ReportedContact",
    "Score",
    "ScoredMission",
    "Truth",
    "TruthObject",
    "parse_contacts",
    "parse_truth",
    "plot",
    "read_contacts",
    "read_truth",
    "score_files",
    "score_json",
    "score_missions",
    "sentence",
    "table",
]
