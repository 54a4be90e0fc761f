"""Judged contacts as training sets and on paper: what was judged is in them, where it lies, and nothing else."""

from __future__ import annotations

import json
import re
import shutil
import zlib
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from auv_mcm.contacts.contact_picture import snippet_png
from auv_mcm.contacts.export import contact_feature
from auv_mcm.errors import BadInputError, UsageError
from auv_mcm.records import Contact
from sim_replay.contact_sheet import sheet_contacts, write_contact_sheet
from sim_replay.report import PictureCollector, Shown
from sim_replay.report.report_file import ReportContents, read_contents, report_contents, write_contents
from sim_replay.training_export import CATEGORIES, judged_chips, write_coco, write_yolo
from sim_replay.verdict_layers import UNMATCHED, with_verdicts
from sim_replay.verdicts import Call, Verdict, append_verdict, read_verdicts
from tests.sim_replay.report_samples import contact, detection, mission

CALLS: tuple[Call, ...] = ("mine_like", "not_mine_like", "undecided")


def contacts() -> list[Contact]:
    """Four contacts 1 km apart, two views of the first; the last is judged by nobody."""
    return [
        contact(
            f"C{number:05d}",
            0.9 / number,
            latitude_deg=55.0 + 0.01 * number,
            covariance_m2=np.eye(2),
            views=(detection("port"), detection("starboard"))[: 2 if number == 1 else 1],
        )
        for number in range(1, 5)
    ]


def judge(folder: Path) -> None:
    for number, call in enumerate(CALLS, 1):
        append_verdict(
            folder,
            Verdict(
                object=f"V{number:04d}",
                time="2026-05-04T10:00:00Z",
                by="kim",
                latitude_deg=55.0 + 0.01 * number,
                longitude_deg=12.0,
                call=call,
                type="rock",
                comment="Überlänge ✓",
            ),
        )


def contents_of(found: list[Contact]) -> ReportContents:
    return report_contents(Shown(mission(), found, [], [], [], {"reader.pings": 3}, PictureCollector()))


def test_what_a_report_was_drawn_from_comes_back(tmp_path: Path) -> None:
    kept = contents_of(contacts())
    write_contents(tmp_path, kept)
    back = read_contents(tmp_path)
    assert [msgspec.to_builtins(contact_feature(one)) for one in back.contacts] == [
        msgspec.to_builtins(contact_feature(one)) for one in kept.contacts
    ]
    assert np.array_equal(back.contacts[0].views[0].snippet, kept.contacts[0].views[0].snippet)
    assert back.mission.name == kept.mission.name
    with pytest.raises(BadInputError, match="Replay the log again"):
        read_contents(tmp_path / "elsewhere")


def test_chips_are_those_judged_mine_like_or_not_with_a_box_in_the_picture(tmp_path: Path) -> None:
    judge(tmp_path)
    chips = judged_chips(tmp_path, contents_of(contacts()))
    assert [chip.name for chip in chips] == ["C00001-1.png", "C00001-2.png", "C00002-1.png"]
    write_coco(tmp_path / "coco", chips, "Line 7")
    write_yolo(tmp_path / "yolo", chips)
    coco = json.loads((tmp_path / "coco" / "annotations.json").read_text(encoding="utf-8"))
    assert [one["name"] for one in coco["categories"]] == list(CATEGORIES)
    assert [one["category_id"] for one in coco["annotations"]] == [1, 1, 2]
    assert coco["annotations"][0]["attributes"]["comment"] == "Überlänge ✓"
    labels = sorted((tmp_path / "yolo" / "labels").iterdir())
    described = (tmp_path / "yolo" / "data.yaml").read_text().splitlines()
    assert described[:2] == ["train: images", "val: images"], "without `path`, folders are looked for beside the file"
    for image, annotation, label in zip(coco["images"], coco["annotations"], labels, strict=True):
        assert image["id"] == annotation["image_id"]
        picture = cv2.imread(str(tmp_path / "coco" / image["file_name"]))
        assert picture is not None
        assert picture.shape[:2] == (image["height"], image["width"])
        left, top, wide, tall = annotation["bbox"]
        assert 0.0 <= left < left + wide <= image["width"]
        assert 0.0 <= top < top + tall <= image["height"]
        assert annotation["area"] == pytest.approx(wide * tall, abs=0.01)
        category, *box = label.read_text().split()
        assert int(category) == annotation["category_id"] - 1
        middle = ((left + wide / 2) / image["width"], (top + tall / 2) / image["height"])
        assert [float(part) for part in box] == pytest.approx(
            [*middle, wide / image["width"], tall / image["height"]], abs=1e-5
        )
        assert (tmp_path / "yolo" / "images" / f"{label.stem}.png").exists()


def test_chips_of_an_export_before_are_not_trained_on_after_their_verdict_is_withdrawn(tmp_path: Path) -> None:
    judge(tmp_path)
    chips = judged_chips(tmp_path, contents_of(contacts()))
    for write in (write_yolo, lambda folder, some: write_coco(folder, some, "Line 7")):
        write(tmp_path / "chips", chips[:2])
        write(tmp_path / "chips", chips)
        with pytest.raises(UsageError, match=r"C00002-1\.png .* Name another folder"):
            write(tmp_path / "chips", chips[:2])
        shutil.rmtree(tmp_path / "chips")


def test_the_box_is_about_the_detection_on_either_side(tmp_path: Path) -> None:
    judge(tmp_path)
    port, starboard, _ = judged_chips(tmp_path, contents_of(contacts()))
    for chip, share in ((port, 1.0 - 10.0 / 60.0), (starboard, 10.0 / 60.0)):
        left, _, wide, _ = chip.box
        assert (left + wide / 2.0) / chip.picture.shape[1] == pytest.approx(share, abs=0.05)


def test_where_nothing_was_judged_there_is_nothing_to_learn(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="auv-mcm view"):
        judged_chips(tmp_path, contents_of(contacts()))


def test_words_of_a_sheet_stay_above_the_lower_margin_however_long_they_are(tmp_path: Path) -> None:
    one: Any = contact_feature(contacts()[0])
    one["properties"] |= {"verdict": "mine_like", "judged_by": "k" * 64, "verdict_comment": "W" * 400}
    write_contact_sheet(tmp_path / "long.pdf", tmp_path, {"contacts": [one] * 9}, "Line 7")
    pages = re.findall(rb"stream\n(.*?)\nendstream", (tmp_path / "long.pdf").read_bytes(), re.DOTALL)
    heights_pt = [float(up) for page in pages for up in re.findall(rb"BT [\d.-]+ ([\d.-]+) Td", zlib.decompress(page))]
    assert len(heights_pt) > 90
    assert min(heights_pt) > 15.0 / 25.4 * 72.0


def test_a_sheet_counts_verdicts_that_no_contact_stands_for(tmp_path: Path) -> None:
    judge(tmp_path)
    alone = with_verdicts({"contacts": []}, read_verdicts(tmp_path))
    write_contact_sheet(tmp_path / "alone.pdf", tmp_path, alone, "Line 7")
    page = re.findall(rb"stream\n(.*?)\nendstream", (tmp_path / "alone.pdf").read_bytes(), re.DOTALL)[0]
    n_unmatched = len(alone[UNMATCHED])
    assert f"{n_unmatched} more unmatched" in zlib.decompress(page).decode("latin-1")


def test_a_sheet_has_every_contact_that_matters_and_is_the_same_each_time(tmp_path: Path) -> None:
    judge(tmp_path)
    found = contacts()
    (tmp_path / "snippets").mkdir()
    (tmp_path / "snippets" / "C00001.png").write_bytes(snippet_png(found[0].views[0]))
    layers = with_verdicts({"contacts": [contact_feature(one) for one in found]}, read_verdicts(tmp_path))
    assert [one["properties"]["id"] for one in sheet_contacts(layers)] == [one.id for one in found]
    for name in ("one.pdf", "two.pdf"):
        write_contact_sheet(tmp_path / name, tmp_path, layers, "Line 7 Ωmega")
    data = (tmp_path / "one.pdf").read_bytes()
    assert data.startswith(b"%PDF-")
    assert data == (tmp_path / "two.pdf").read_bytes()
    for damaged in (b"", snippet_png(found[0].views[0])[:300]):
        (tmp_path / "snippets" / "C00001.png").write_bytes(damaged)
        write_contact_sheet(tmp_path / "damaged.pdf", tmp_path, layers, "")
        assert (tmp_path / "damaged.pdf").read_bytes().startswith(b"%PDF-")
    write_contact_sheet(tmp_path / "empty.pdf", tmp_path, {"contacts": []}, "")
    assert (tmp_path / "empty.pdf").read_bytes().startswith(b"%PDF-")
