"""The page in a real browser: a phone needs no sideways scrolling, and headings sort.

Needs Chromium or Chrome on the PATH; skipped without, since pip cannot install one.
"""

import json
import os
import re
import shutil
import subprocess
from html import escape, unescape
from pathlib import Path
from typing import Any

import pytest

from cpgrl_opt.comparison.measurement import Measurement, cells_of
from cpgrl_opt.comparison.report import ReportContext, write_report

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="needs Chromium or Chrome on the PATH")

WIDTHS = (360, 1280)
PROBE = """
const maps = [...document.querySelectorAll("table.heat")];
const grid = maps[0];
const column = (n) => [...grid.tBodies[grid.tBodies.length - 1].rows].map((row) => row.cells[n].dataset.value);
const press = (n) => grid.querySelectorAll("thead th")[n].querySelector("button").click();
const found = { width: innerWidth, page: document.documentElement.scrollWidth };
found.outside = [...document.querySelectorAll("main *")]
  .filter((e) => !e.closest("table, pre, svg") && e.getBoundingClientRect().right > innerWidth + 0.5)
  .map((e) => e.tagName + "." + e.className);
found.scrolling = maps.some((map) => map.parentElement.scrollWidth > map.parentElement.clientWidth);
grid.parentElement.scrollLeft = 200;
const head = grid.tBodies[1].rows[0].cells[0].getBoundingClientRect();
found.sticky = head.left - grid.parentElement.getBoundingClientRect().left;
press(12); found.up = column(12); found.mark = grid.querySelector("[aria-sort]").getAttribute("aria-sort");
press(12); found.down = column(12);
press(0); found.back = column(0);
found.total = grid.tBodies[0].textContent;
parent.document.body.setAttribute(`data-found-${innerWidth}`, JSON.stringify(found));
"""


def measurements() -> list[Measurement]:
    """Twelve solvers and eight families with long names; solver-0, the last column, does not take one of them."""
    return [
        Measurement(
            solver=solver, variant=variant, family=family, problem=problem, n=9, m=3, status="OPTIMAL",
            outcome="unsupported" if (solver, family) == ("solver-0", "family-3-with-equality-and-bounds")
            else "success" if problem < (place * 7) % 10 else "silently-wrong",
            worst=0.0, distance=None, seconds=1.0, ratio=1.0 + len(solver), limit=1.0, noise=False,
        )
        for variant in ("prepared", "raw")
        for solver in (f"solver-{index}" for index in range(12))
        for place, family in enumerate(f"family-{index}-with-equality-and-bounds" for index in range(8))
        for problem in range(10)
    ]  # fmt: skip


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[int, dict[str, Any]]:
    """Width → what PROBE finds in a frame of this width (a window of its own is never below 500 pixels)."""
    about = ReportContext(
        command="cpgrl compare " + "--solvers a-long-list-of-names " * 9, machine={"processor": "a" * 90},
        versions={"numpy": "2.4"}, settings={"limit, s": 5}, families={}, seed=0, wall_seconds=1.0,
    )  # fmt: skip
    folder = tmp_path_factory.mktemp("page")
    given = measurements()
    page = write_report(cells_of(given), given, about, folder)[1].read_text(encoding="utf-8")
    inside = escape(page.replace("</body>", f"<script>{PROBE}</script></body>"))
    frames = [f'<iframe style="width:{width}px;height:800px;border:0" srcdoc="{inside}"></iframe>' for width in WIDTHS]
    probed = folder / "probed.html"
    probed.write_text(f'<!DOCTYPE html><meta charset="utf-8"><body>{"".join(frames)}</body>', encoding="utf-8")
    return {width: _attribute(f"data-found-{width}", dom) for dom in [_dom(probed)] for width in WIDTHS}


def _dom(page: Path) -> str:
    """The page after its scripts ran."""
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run", "--dump-dom"]
    run = subprocess.run(
        [str(BROWSER), *options, f"--user-data-dir={page.parent / 'profile'}", page.as_uri()],
        capture_output=True, text=True, encoding="utf-8", timeout=120, check=True,
        env={**os.environ, "HOME": str(page.parent)},
    )  # fmt: skip
    return run.stdout


def _attribute(name: str, dom: str) -> dict[str, Any]:
    match = re.search(f'{name}="([^"]*)"', dom)
    assert match, f"no {name}"
    return dict(json.loads(unescape(match[1])))


def test_a_phone_scrolls_tables_in_their_boxes_and_never_the_page(found: dict[int, dict[str, Any]]) -> None:
    phone = found[360]
    assert (phone["width"], phone["page"], phone["outside"]) == (360, 360, [])
    assert phone["scrolling"] is True
    assert abs(phone["sticky"]) <= 2.0


def test_a_desktop_shows_the_maps_whole(found: dict[int, dict[str, Any]]) -> None:
    desktop = found[1280]
    assert (desktop["width"], desktop["page"], desktop["outside"]) == (1280, 1280, [])
    assert desktop["scrolling"] is False


@pytest.mark.parametrize("width", WIDTHS)
def test_headings_sort_up_and_down_with_the_total_on_top_and_what_has_no_value_last(
    found: dict[int, dict[str, Any]], width: int
) -> None:
    seen = found[width]
    assert seen["up"][-1] == seen["down"][-1] == ""
    up, down = ([float(value) for value in seen[way][:-1]] for way in ("up", "down"))
    assert up == sorted(up)
    assert len(set(up)) == 7
    assert down == up[::-1]
    assert seen["back"] == [str(index) for index in range(8)]
    assert seen["mark"] == "ascending"
    assert "all families" in seen["total"]
