"""What is drawn is what was counted: bars, shades of maps, curves; and every shade can be read."""

import re
from pathlib import Path

import pytest

from cpgrl_opt.comparison.findings import Findings, find
from cpgrl_opt.comparison.heat_colours import LEVELS, heat_styles, level
from cpgrl_opt.comparison.heat_map import heat_maps, time_map
from cpgrl_opt.comparison.measurement import Measurement, cells_of
from cpgrl_opt.comparison.outcome_bars import outcome_bars
from cpgrl_opt.comparison.profile_drawing import overview, panels
from cpgrl_opt.comparison.report import ReportContext, write_report


def measurement(solver: str, problem: int, outcome: str, ratio: float, family: str = "a") -> Measurement:
    return Measurement(
        solver=solver, variant="prepared", family=family, problem=problem, n=9, m=3, status="OPTIMAL", outcome=outcome,
        worst=0.0, distance=None, seconds=ratio, ratio=ratio, limit=1e3, noise=False,
    )  # fmt: skip


MEASUREMENTS = [
    *(measurement("good", problem, "success", 1.0) for problem in range(4)),
    measurement("bad", 0, "success", 10.0),
    measurement("bad", 1, "silently-wrong", 0.1),
    measurement("bad", 2, "hang", 10.0),
    measurement("bad", 3, "crash", 10.0),
    *(measurement("good", problem, "success", 2.0, "b") for problem in range(4)),
    *(measurement("bad", problem, "success", 0.5, "b") for problem in range(4)),
]
CONTEXT = ReportContext(
    command="", machine={}, versions={}, settings={}, families={"b": "second", "a": "first"}, seed=0, wall_seconds=0.0
)


@pytest.fixture(scope="module")
def findings() -> Findings:
    return find(cells_of(MEASUREMENTS), MEASUREMENTS, CONTEXT)


def test_each_bar_is_a_hundred_percent_long(findings: Findings) -> None:
    bars = re.findall(r'<div class="bar".*?</div>', str(outcome_bars(findings)), flags=re.S)
    parts = [dict(re.findall(r'<i class="(\w+)" style="flex-grow:([\d.]+)"', bar)) for bar in bars]
    assert parts == [{"good": "100"}, {"good": "62.5", "ended": "25", "wrong": "12.5"}]


def test_a_cell_has_the_shade_of_its_share(findings: Findings) -> None:
    success = re.search(r'"#family-a".*?</tr>', str(heat_maps(findings)), flags=re.S)
    assert success
    assert re.findall(r'class="(success-\d+)"', success[0]) == [f"success-{LEVELS - 1}", f"success-{level(0.25)}"]


def test_the_time_map_shows_ratios_by_their_logarithm(findings: Findings) -> None:
    row = re.search(r'"#family-b".*?</tr>', str(time_map(findings)), flags=re.S)
    assert row
    assert re.findall(r'class="(time-\d+)" data-value="[\d.]+">([\d.]+)<', row[0]) == [
        ("time-2", "2"),
        ("time-0", "0.5"),
    ]


def test_only_all_and_none_have_the_outermost_shades() -> None:
    shades = [level(share) for share in (0.0, 0.001, 0.5, 0.999, 1.0)]
    assert shades == [0, 1, 6, LEVELS - 2, LEVELS - 1]


@pytest.mark.parametrize("scheme", [0, 1])
@pytest.mark.parametrize("ramp", ["success", "wrong", "time"])
def test_shades_differ_in_lightness_in_one_direction_and_their_ink_can_be_read(scheme: int, ramp: str) -> None:
    block = heat_styles().split("@media")[scheme]
    colours = re.findall(rf"\.{ramp}-\d+{{background:(#\w+);color:(#\w+)}}", block)
    lights = [luminance(background) for background, _ in colours]
    assert len(lights) == LEVELS
    assert lights in (sorted(set(lights)), sorted(set(lights), reverse=True))
    for light, (_, ink) in zip(lights, colours, strict=True):
        low, high = sorted((light, luminance(ink)))
        assert (high + 0.05) / (low + 0.05) >= 4.5  # WCAG 2.2, 1.4.3


def luminance(code: str) -> float:
    """WCAG's relative luminance of #rgb or #rrggbb."""
    digits = code[1:] if len(code) == 7 else "".join(2 * digit for digit in code[1:])
    channels = [int(digits[start : start + 2], 16) / 255 for start in (0, 2, 4)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return sum(weight * each for weight, each in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def test_a_curve_ends_at_the_share_solved_and_a_failure_never_lifts_it(findings: Findings) -> None:
    drawing = str(overview(findings))
    heights = {text: float(y) for y, text in re.findall(r'y="([\d.]+)" text-anchor="end">(\d+)<', drawing)}
    ends = [
        float(path.rsplit("V", 1)[1].split("H")[0]) + 4
        for path in re.findall(r'<path d="(\S* \S*)" class="curve', drawing)
    ]
    bottom, top = heights["0"], heights["100"]
    assert bottom > top
    assert ends == pytest.approx([top, bottom + (top - bottom) * 0.625], abs=0.2)
    assert "good 100 %" in drawing
    assert "bad 62.5 %" in drawing
    assert str(panels(findings)).count('class="own prepared"') == 2


def test_the_family_table_counts_who_solves_all_and_names_the_fastest(findings: Findings, tmp_path: Path) -> None:
    second, first = findings.rows
    assert (second.family, second.solving, second.asked, second.fastest) == ("b", ("good", "bad"), 2, "bad")
    assert (first.family, first.solving, first.asked, first.fastest) == ("a", ("good",), 2, "good")
    assert second.time_ratio == pytest.approx(0.5)
    html = write_report(cells_of(MEASUREMENTS), MEASUREMENTS, CONTEXT, tmp_path)[1].read_text(encoding="utf-8")
    assert re.search(r'id="family-a".*?1 of 2.*?</tr>', html, flags=re.S)
