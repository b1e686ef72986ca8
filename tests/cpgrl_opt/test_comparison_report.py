"""The documents say what the cells say, in well-formed HTML that needs no other file."""

import random
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from markdown_it import MarkdownIt  # which rich needs

from cpgrl_opt.comparison.measurement import OUTCOMES, Measurement
from cpgrl_opt.comparison.report import ReportContext, percent_text, write_report
from cpgrl_opt.comparison.table import as_table, count_cells

from . import comparisons

SOLVERS = ("active-set", "nnls", "quadprog", "osqp", "rosen")
FAMILIES = {
    "well-conditioned": "Gaussian rows",
    "opposing-1e-6": "two rows at π − 1e-6 rad",
    "row-scales-1e6": 'lengths 1e±6, <b>"quoted" & |piped|</b>',
    "infeasible": "a Farkas vector by construction",
    "equality": "tangent face",
}
HOSTILE = "<script>alert('x')</script>&\"|"


def measurement(solver: str, variant: str, family: str, problem: int, outcome: str, ratio: float = 1.0) -> Measurement:
    told = {"solver": solver, "variant": variant, "family": family, "problem": problem, "outcome": outcome}
    return comparisons.measurement(**told, worst=1e-15, distance=1e-15, ratio=ratio, seconds=1e-5 * ratio, limit=1.0)


def drawn(seed: int = 0, problems: int = 8) -> list[Measurement]:
    """Each outcome by chance; `rosen` takes equalities only, and is not measured raw."""
    rng = random.Random(seed)
    found = []
    for variant in ("prepared", "raw"):
        for place, solver in enumerate(SOLVERS[: 4 if variant == "raw" else 5]):
            for family in FAMILIES:
                for problem in range(problems):
                    chance = 0.9 if variant == "prepared" else 0.5
                    outcome = "success" if rng.random() < chance else rng.choice(OUTCOMES[1:-1])
                    if solver == "rosen" and family != "equality":
                        outcome = "unsupported"
                    ratio = (1.0 + 3 * place) * rng.uniform(0.8, 1.25)
                    found.append(measurement(solver, variant, family, problem, outcome, ratio))
    return found


def context(**changes: object) -> ReportContext:
    settings = {
        "command": f"cpgrl compare --out {HOSTILE}",
        "machine": {"system": "Linux", "cores": 2},
        "versions": {"python": "3.11", "numpy": "2.4"},
        "settings": {"time limit, s": 5.0, "note": HOSTILE},
        "families": FAMILIES,
        "seed": 3,
        "wall_seconds": 12.0,
    }
    return ReportContext(**{**settings, **changes})  # type: ignore[arg-type]


class Page(HTMLParser):
    """Refuses tags that are not closed in order; keeps attributes, tables and text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.tables: list[list[list[str]]] = []
        self.text: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == [], f"never closed: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in ("meta", "img"):
            self.open.append(tag)
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.tables[-1][-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)
        if ("td" in self.open or "th" in self.open) and self.tables[-1][-1]:
            self.tables[-1][-1][-1] += data


def written(folder: Path, measurements: list[Measurement], about: ReportContext) -> tuple[str, str]:
    markdown, html = write_report(measurements, about, folder)
    return markdown.read_text(encoding="utf-8"), html.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def documents(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    return written(tmp_path_factory.mktemp("report"), drawn(), context())


def test_the_page_is_well_formed_and_needs_no_other_file(documents: tuple[str, str]) -> None:
    page = Page(documents[1])
    assert not any(word in documents[1].lower() for word in ("http:", "https:", "url(", "@import", "<script", "href="))
    assert all(value.startswith("data:image/png;") for _, name, value in page.attributes if name == "src")


def test_the_same_input_gives_the_same_bytes(documents: tuple[str, str], tmp_path: Path) -> None:
    assert written(tmp_path, drawn(), context()) == documents


def test_the_success_map_shows_every_cell(documents: tuple[str, str]) -> None:
    cells = {(cell.solver, cell.variant, cell.family): cell for cell in count_cells(as_table(drawn())).itertuples()}
    maps = [table for table in Page(documents[1]).tables if table[0][0] == "family" and table[0][1] in SOLVERS]
    for grid, variant in zip(maps[:2], ("prepared", "raw"), strict=True):
        solvers = grid[0][1:]
        assert [row[0] for row in grid[1:]] == ["all families", *FAMILIES]
        for family, *row in grid[2:]:
            for solver, text in zip(solvers, row, strict=True):
                cell = cells[solver, variant, family]
                taken = cell.problems - cell.unsupported
                assert text == (percent_text(100 * cell.success / taken, 0) if taken else "–")


def test_the_main_table_of_both_documents_is_that_of_the_cells(documents: tuple[str, str]) -> None:
    cells = [*count_cells(as_table(drawn())).itertuples()]
    (page,) = [t for t in Page(documents[1]).tables if "honest failure %" in t[0]]
    lines = [line for line in documents[0].splitlines() if line.startswith("| `")][: len(page) - 1]
    for row, line in zip(page[1:], lines, strict=True):
        assert [text.strip().strip("`") for text in line.strip(" |").split("|")] == row
        own = [cell for cell in cells if (cell.solver, cell.variant) == (row[0], row[1])]
        taken = sum(cell.problems - cell.unsupported for cell in own)
        assert int(row[2]) == taken
        for place, outcome in ((3, "success"), (5, "silently_wrong"), (6, "honest_failure"), (8, "missed_infeasible")):
            exact = 100 * sum(getattr(cell, outcome) for cell in own) / taken
            assert float(row[place]) == pytest.approx(exact, abs=0.05 + 1e-9)
        assert int(row[9]) == sum(cell.hang for cell in own)


def test_text_of_others_stays_text(documents: tuple[str, str]) -> None:
    markdown, html = documents
    page = Page(html)
    assert "<script" not in html
    assert HOSTILE in "".join(page.text)
    assert FAMILIES["row-scales-1e6"] in "".join(page.text)
    rows = [line for line in markdown.splitlines() if line.startswith("| `row-scales")]
    assert rows
    assert all(line.count("|") == 8 for line in rows)


MARKED = "<b>b</b> <!-- --> *e* _i_ __init__ `c` | \\| [l](u) ![p](q) &amp; ~~s~~ $x$ \\\n\n# h\n\n<script>1</script>"


def tags(markdown: str) -> list[str]:
    """Of the page as a reader sees it, but for code, which a name may be set as in two ways."""
    page = MarkdownIt("commonmark").enable(["table", "strikethrough"]).render(markdown)
    return [tag for tag in re.findall(r"<(\w+)", page) if tag != "code"]


def test_names_and_reasons_of_others_stay_text_in_markdown(tmp_path: Path) -> None:
    def of(name: str) -> str:
        told = [measurement(name, variant, name, k, OUTCOMES[k]) for variant in ("prepared", "raw") for k in range(3)]
        about = context(command=name, families={name: name}, versions={name: name}, settings={name: name})
        return written(tmp_path / str(len(name)), told, replace(about, ill_posed=[name]))[0]

    assert tags(of(MARKED)) == tags(of("plain"))


def test_a_percentage_reads_100_or_0_only_where_it_is() -> None:
    assert [percent_text(value) for value in (100.0, 100.0 - 1e-9, 50.0, 0.01, 0.0, float("nan"))] == [
        "100",
        "99.9",
        "50.0",
        "<0.1",
        "0",
        "–",
    ]
    assert [percent_text(value, 0) for value in (99.9, 28.999999999999996, 66.7, 0.4)] == ["99", "29", "67", "<1"]


def test_both_documents_say_machine_versions_settings_command_seed_and_limitations(documents: tuple[str, str]) -> None:
    for text in (documents[0], "".join(Page(documents[1]).text)):
        for words in ("Linux", "3.11", "numpy", "time limit, s", "cpgrl compare --out", "Seed 3; 12 s", "Limitations"):
            assert words in text


@pytest.mark.parametrize("variants", [(), ("prepared",), ("raw",)])
def test_a_part_of_the_comparison_can_be_reported(variants: tuple[str, ...], tmp_path: Path) -> None:
    part = [each for each in drawn() if each.variant in variants]
    markdown, html = written(tmp_path, part, context())
    Page(html)
    assert ("What the preparation buys" in markdown, "What the preparation buys" in html) == (False, False)
    assert "nan" not in markdown


def test_what_float64_does_not_determine_has_a_distance_of_its_own(tmp_path: Path) -> None:
    near = [replace(each, distance=1e-11) for each in drawn() if each.outcome == "success"]
    far = [
        replace(each, distance=0.6 if (each.solver, each.problem) == ("nnls", 1) else 1e-9)
        for each in near if each.family == "opposing-1e-6"
    ]  # fmt: skip
    measurements = [each for each in near if each.family != "opposing-1e-6"] + far
    counted = sum(each.variant == "prepared" for each in far)
    assert any(each.distance == 0.6 and each.variant == "prepared" for each in far)
    pooled = written(tmp_path / "pooled", measurements, context())
    apart = written(tmp_path / "apart", measurements, context(ill_posed=["opposing-1e-6", "infeasible"]))
    assert "| 1e-11 | 6e-01 |" in next(line for line in apart[0].splitlines() if line.startswith("| `nnls` | prepared"))
    assert "| 6e-01 | – |" in next(line for line in pooled[0].splitlines() if line.startswith("| `nnls` | prepared"))
    assert f"| `opposing-1e-6` | {counted} | 1 | 6e-01 |" in apart[0]
    assert "Certified, yet far" in apart[1]
    assert "Certified, yet far" not in pooled[0] + pooled[1]
