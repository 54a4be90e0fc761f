"""The mission report: `PictureCollector` watches tiles stream by, `write_report` makes one self-contained HTML page at the end."""

from sim_replay.report.page import MissionRecord, render_report, write_report
from sim_replay.report.pictures import PictureCollector

__all__ = ["MissionRecord", "PictureCollector", "render_report", "write_report"]
