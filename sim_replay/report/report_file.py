"""Keep what a report was drawn from beside it, so that it can be drawn again with what people have judged since."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from auv_mcm import __version__
from auv_mcm.contacts.record_file import packed, record_decoder
from auv_mcm.errors import BadInputError
from auv_mcm.records import Contact, CoveragePatch, Detection, Notice, Waypoint
from auv_mcm.safe_files import open_regular
from auv_mcm.shell.whole_files import write_file
from sim_replay.report.page import MAX_CARDS, MAX_ROWS, MissionRecord, Shown, ranked_contacts, write_report
from sim_replay.report.pictures import PictureStrip
from sim_replay.verdicts import read_verdicts

REPORT_CONTENTS: Final = "report-contents.bin"
REPORT: Final = "report.html"
_QUICK: Final = 1  # level of zlib: pictures are compressed already, the rest shrinks to a third at once


class ReportContents(msgspec.Struct, frozen=True, kw_only=True, eq=False):
    """Hold all that a report shows but verdicts, as `write_report` takes it.

    version: of the package that wrote it. times_m, times_s: (n,) as of `PictureCollector.times`.
    """

    version: str
    mission: MissionRecord
    contacts: tuple[Contact, ...]
    patches: tuple[CoveragePatch, ...]
    waypoints: tuple[Waypoint, ...]
    notices: tuple[Notice, ...]
    counters: dict[str, float]
    kept_strips: tuple[PictureStrip, ...]
    times_m: NDArray[np.float64]
    times_s: NDArray[np.float64]

    def strips(self) -> tuple[PictureStrip, ...]:
        """Give the strips of the waterfall."""
        return self.kept_strips

    def times(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Give places along the track, m, and the times there."""
        return self.times_m, self.times_s


def report_contents(shown: Shown) -> ReportContents:
    """Keep what a report shows; contacts too unlikely for its table lose their pictures."""
    unlisted = {contact.id for contact in ranked_contacts(shown.contacts)[MAX_CARDS + MAX_ROWS :]}
    times_m, times_s = shown.pictures.times()
    return ReportContents(
        version=__version__,
        mission=shown.mission,
        contacts=tuple(_without_pictures(one) if one.id in unlisted else one for one in shown.contacts),
        patches=tuple(msgspec.structs.replace(patch, cells=None) for patch in shown.patches),
        waypoints=tuple(shown.waypoints),
        notices=tuple(shown.notices),
        counters=dict(shown.counters),
        kept_strips=shown.pictures.strips(),
        times_m=times_m,
        times_s=times_s,
    )


def write_contents(folder: Path, contents: ReportContents) -> None:
    """Write the file that a report can be drawn from again."""
    write_file(folder / REPORT_CONTENTS, zlib.compress(packed(contents), _QUICK))


def read_contents(folder: Path) -> ReportContents:
    """Read what a report was drawn from. Raises BadInputError for a folder without it, or of another version."""
    path = folder / REPORT_CONTENTS
    again = "Replay the log again into this folder"
    if not path.is_file():
        raise BadInputError(f"{folder} does not hold what its report was drawn from ({REPORT_CONTENTS}). {again}.")
    try:
        with open_regular(path) as file:
            contents = record_decoder(ReportContents).decode(zlib.decompress(file.read()))
    except (OSError, zlib.error, msgspec.MsgspecError, ValueError, TypeError) as error:
        raise BadInputError(f"{path} is damaged, or of another version: {error}. {again}.") from error
    if contents.version != __version__:
        raise BadInputError(f"{path} is of version {contents.version}, this is {__version__}. {again}.")
    return contents


def redraw_report(folder: Path) -> ReportContents:
    """Draw the report of results again, with the verdicts of now. Raises BadInputError as `read_contents` does."""
    kept = read_contents(folder)
    mission = msgspec.structs.replace(kept.mission, verdicts=read_verdicts(folder))
    shown = Shown(mission, kept.contacts, kept.patches, kept.waypoints, kept.notices, kept.counters, kept)
    write_report(folder / REPORT, shown)
    return msgspec.structs.replace(kept, mission=mission)


def _without_pictures(contact: Contact) -> Contact:
    return msgspec.structs.replace(contact, views=tuple(map(_without_picture, contact.views)))


def _without_picture(view: Detection) -> Detection:
    found, nothing = view.confirmation, np.zeros((0, 0), dtype=np.uint8)
    if found is not None:
        found = msgspec.structs.replace(found, labels=nothing)
    return msgspec.structs.replace(view, snippet=nothing, confirmation=found)
