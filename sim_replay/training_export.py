"""Write judged contacts as pictures with boxes, for training other detectors: COCO and YOLO."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_mcm.contacts.contact import sigma_m
from auv_mcm.contacts.contact_picture import encoded, in_picture, snippet_picture
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import Contact, Detection
from auv_mcm.shell.whole_files import make_directory, write_file
from sim_replay.report.report_file import ReportContents
from sim_replay.verdicts import Place, Verdict, match_verdicts, read_verdicts

CATEGORIES: Final = ("mine_like", "not_mine_like")
"""Calls that a chip is written for, in the order of their numbers; what is undecided teaches nothing."""
_MIN_BOX_M: Final = 1.0  # m: of a view without contours, so that echo and shadow of the smallest mine are in it


class Chip(NamedTuple):
    """Hold a judged view. name: of its file; box: left, top, width, height in pixels of the picture."""

    name: str
    picture: NDArray[np.uint8]
    box: tuple[float, float, float, float]
    contact: Contact
    view: Detection
    verdict: Verdict


def judged_chips(results: Path, contents: ReportContents) -> list[Chip]:
    """Cut a chip out of every view of every contact judged mine-like or not, in the order of contacts and views.

    Raises BadInputError where nothing was judged, or if a verdict is damaged.
    """
    places = [Place(one.id, one.latitude_deg, one.longitude_deg, sigma_m(one)) for one in contents.contacts]
    matched = match_verdicts(read_verdicts(results), places)
    chips = [
        chip
        for contact in contents.contacts
        if (verdict := matched.get(contact.id)) is not None and verdict.call in CATEGORIES
        for chip in _chips(contact, verdict)
    ]
    if not chips:
        raise BadInputError(
            f"no contact of {results} is judged mine-like or not mine-like, so that there is nothing to learn from. "
            f"Judge some: 'auv-mcm view {results}'."
        )
    return chips


def write_coco(folder: Path, chips: list[Chip], name: str) -> None:
    """Write `images/` and `annotations.json` (COCO detection). Raises UsageError or OSError.

    Parameters
    ----------
    folder
        Made if it is not there.
    chips
        Of `judged_chips`.
    name
        Of the mission.
    """
    _write_images(folder, chips)
    images = [
        {
            "id": number,
            "file_name": f"images/{chip.name}",
            "width": chip.picture.shape[1],
            "height": chip.picture.shape[0],
        }
        for number, chip in enumerate(chips, 1)
    ]
    annotations = [
        {
            "id": number,
            "image_id": number,
            "category_id": 1 + CATEGORIES.index(chip.verdict.call),
            "bbox": list(chip.box),
            "area": round(chip.box[2] * chip.box[3], 2),
            "iscrowd": 0,
            "attributes": {
                "contact": chip.contact.id,
                "type": chip.verdict.type,
                "comment": chip.verdict.comment,
                "judged_by": chip.verdict.by,
                "p_mine": None if math.isnan(chip.contact.p_mine) else round(chip.contact.p_mine, 4),
                "side": chip.view.side,
            },
        }
        for number, chip in enumerate(chips, 1)
    ]
    categories = [{"id": 1 + number, "name": call} for number, call in enumerate(CATEGORIES)]
    whole = {
        "info": {"description": f"judged sonar contacts of {name}"},
        "images": images,
        "annotations": annotations,
        "categories": categories,
    }
    write_file(folder / "annotations.json", json.dumps(whole, indent=1, ensure_ascii=False).encode("utf-8", "replace"))


def write_yolo(folder: Path, chips: list[Chip]) -> None:
    """Write `images/`, `labels/` and `data.yaml` (YOLO detection). Raises UsageError or OSError."""
    _write_images(folder, chips)
    make_directory(folder / "labels")
    for chip in chips:
        height, width = chip.picture.shape[:2]
        left, top, wide, tall = chip.box
        parts = ((left + wide / 2.0) / width, (top + tall / 2.0) / height, wide / width, tall / height)
        line = " ".join([str(CATEGORIES.index(chip.verdict.call)), *(f"{part:.6f}" for part in parts)])
        write_file(folder / "labels" / f"{Path(chip.name).stem}.txt", f"{line}\n".encode())
    names = "\n".join(f"  {number}: {call}" for number, call in enumerate(CATEGORIES))
    write_file(folder / "data.yaml", f"train: images\nval: images\nnames:\n{names}\n".encode())


def _write_images(folder: Path, chips: list[Chip]) -> None:
    make_directory(folder)
    images = make_directory(folder / "images")
    if others := {path.name for path in images.glob("*.png")} - {chip.name for chip in chips}:
        raise UsageError(
            f"{images} holds {min(others)} and other pictures that are not of this export: they would be trained on "
            "too. Name another folder, or remove them."
        )
    for chip in chips:
        write_file(images / chip.name, encoded(chip.picture, ".png", []))


def _chips(contact: Contact, verdict: Verdict) -> Iterator[Chip]:
    for number, view in enumerate(contact.views, 1):
        if view.snippet.size:
            picture = snippet_picture(view)
            yield Chip(f"{contact.id}-{number}.png", picture, _box(view, picture), contact, view, verdict)


def _box(view: Detection, picture: NDArray[np.uint8]) -> tuple[float, float, float, float]:
    """Bound echo and shadow where they are outlined, otherwise a square about the detection, within the picture."""
    found = view.confirmation
    drawn = [found.highlight, found.shadow] if found is not None else []
    outlines = [outline for outline in drawn if len(outline)]
    if outlines:
        points = np.concatenate(outlines)
    else:
        half_m = 0.5 * max(view.length_m if math.isfinite(view.length_m) else 0.0, _MIN_BOX_M)
        half = np.array([half_m / view.row_spacing_m, half_m / view.column_spacing_m])
        middle = np.array([view.snippet_row, view.snippet_column])
        points = np.array([middle - half, middle + half])
    height, width = picture.shape[:2]
    corners = np.clip(in_picture(view, points), 0.0, 1.0) * (width, height)
    (left, top), (right, bottom) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return round(left, 2), round(top, 2), round(right - left, 2), round(bottom - top, 2)
