"""The page of a report in a real browser: its own script runs under its policy, and the table and the map obey."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path
from typing import Any, Final

import pytest

from sim_replay.verdicts import Verdict
from tests.sim_replay.report_samples import contact, mission
from tests.sim_replay.test_report import full_page

BROWSER: Final = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
PROBE: Final = """
const box = document.querySelector('.table');
const texts = (rows) => rows.filter((row) => !row.hidden).map((row) => row.dataset.id);
const rows = () => texts(Array.from(document.querySelectorAll('#table tbody tr')));
const found = {first: rows(), cut_px: box.scrollWidth - box.clientWidth};
const heads = Array.from(document.querySelectorAll('#table th'));
heads[1].querySelector('button').click(); found.by_p = rows();
heads[1].querySelector('button').click(); found.by_p_rising = rows();
const form = document.getElementById('filter');
const type = (name, value) => {
  form[name].value = value;
  form[name].dispatchEvent(new Event('input', {bubbles: true}));
};
type('words', 'c0002'); found.words = rows(); type('words', '');
type('verdict', 'judged'); found.judged = rows(); type('verdict', 'none');
found.not_judged = rows(); type('verdict', '');
type('least', '0.5'); found.least = rows();
found.out = Array.from(document.querySelectorAll('.chart a.out')).map((mark) => mark.dataset.id);
const chart = document.querySelector('.chart'), before = chart.getAttribute('viewBox');
chart.dispatchEvent(new KeyboardEvent('keydown', {key: '+'}));
found.zoomed = Number(before.split(' ')[2]) / Number(chart.getAttribute('viewBox').split(' ')[2]);
document.getElementById('map-back').click(); found.back = chart.getAttribute('viewBox').split(' ').map(Number);
found.rings = Array.from(document.querySelectorAll('.box.p1, .box.p2')).map((box) => {
  const words = box.querySelector('b'), ring = box.getBoundingClientRect();
  words.style.display = 'block';
  const name = words.getBoundingClientRect(), x = (ring.left + ring.right) / 2, y = (ring.top + ring.bottom) / 2;
  const aside = Math.min(Math.abs(name.left - x), Math.abs(name.right - x));
  const isAlike = getComputedStyle(words).color === getComputedStyle(box, '::before').borderTopColor;
  return [Math.max(aside, Math.abs((name.top + name.bottom) / 2 - y)), isAlike];
});
document.body.dataset.found = JSON.stringify(found);
"""


def shown(page: str, path: Path) -> str:
    """Load a page and return its document as it stands after its scripts."""
    if BROWSER is None:
        pytest.skip("no Chromium is installed (apt-get install chromium)")
    path.write_text(page, encoding="utf-8")
    words = (
        BROWSER,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--window-size=1400,900",
        f"--user-data-dir={path.parent / 'profile'}",
    )
    done = subprocess.run((*words, "--dump-dom", path.as_uri()), capture_output=True, timeout=120, check=True)
    return done.stdout.decode()


def test_table_and_map_obey(tmp_path: Path) -> None:
    contacts = [contact("C0001", 0.9), contact("C0002", 0.3, classification="clutter"), contact("C0003", 0.6)]
    one = Verdict(object="V0001", time="2026-05-04T10:00:00Z", by="kim", latitude_deg=55.0, longitude_deg=12.0)
    page = full_page(contacts=contacts, mission=mission(verdicts=(one,)))
    unlocked = re.sub(r'<meta http-equiv="Content-Security-Policy".*?>', "", page)
    probed = shown(unlocked.replace("</body>", f"<script>{PROBE}</script></body>"), tmp_path / "probed.html")
    (text,) = re.findall(r'data-found="(.*?)"', probed)
    found: dict[str, Any] = json.loads(unescape(text))
    assert found["first"] == found["by_p"] == ["C0001", "C0003", "C0002"]
    assert found["by_p_rising"] == ["C0002", "C0003", "C0001"]
    assert found["words"] == ["C0002"]
    assert [len(found["judged"]), len(found["not_judged"])] == [1, 2]
    assert sorted(found["least"]) == ["C0001", "C0003"]
    assert found["cut_px"] <= 0  # no column of the table is cut off
    assert found["out"] == ["C0002"]
    assert found["zoomed"] == pytest.approx(1.5)
    assert found["back"][:2] == [0, 0]
    assert found["rings"]
    assert all(away_px < 10.0 and is_alike for away_px, is_alike in found["rings"])  # a name stands at its own ring


def test_the_policy_admits_the_script_of_the_page_and_no_other(tmp_path: Path) -> None:
    page = full_page().replace("</body>", "<script>document.body.dataset.found = 'yes'</script></body>")
    document = shown(page, tmp_path / "report.html")
    assert 'class="scripted"' in document
    assert "data-found" not in document
