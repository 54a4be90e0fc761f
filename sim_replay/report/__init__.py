"""Report a mission: `PictureCollector` collects pictures of tiles, `write_report` makes one self-contained page."""

from sim_replay.report.page import MissionRecord, Shown, render_report, write_report
from sim_replay.report.pictures import PictureCollector

__all__ = ["MissionRecord", "PictureCollector", "Shown", "render_report", "write_report"]
