"""Scoring of contacts against truth."""

from sim_replay.scoring.inputs import Mission, ReportedContact, Truth, TruthObject, parse_contacts, parse_truth, read_contacts, read_truth
from sim_replay.scoring.plot import plot
from sim_replay.scoring.score import Score, score_files, score_missions, to_json
from sim_replay.scoring.table import table

__all__ = [
    "Mission",
    "ReportedContact",
    "Score",
    "Truth",
    "TruthObject",
    "parse_contacts",
    "parse_truth",
    "plot",
    "read_contacts",
    "read_truth",
    "score_files",
    "score_missions",
    "table",
    "to_json",
]
