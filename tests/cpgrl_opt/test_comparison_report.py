"""The documents say what the cells say, in well-formed HTML that needs no other file."""

import random
from html.parser import HTMLParser
from pathlib import Path

import pytest

from cpgrl_opt.comparison.measurement import OUTCOMES, Measurement, cells_of
from cpgrl_opt.comparison.report import ReportContext, write_report

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
    return Measurement(
        solver=solver, variant=variant, family=family, problem=problem, n=9, m=3, status="OPTIMAL", outcome=outcome,
        worst=1e-15, distance=1e-15, seconds=1e-5 * ratio, ratio=ratio, limit=1.0, noise=False,
    )  # fmt: skip


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
        if tag not in ("meta",):
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
    markdown, html = write_report(cells_of(measurements), measurements, about, folder)
    return markdown.read_text(encoding="utf-8"), html.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def documents(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    return written(tmp_path_factory.mktemp("report"), drawn(), context())


def test_both_documents_name_every_solver_and_family(documents: tuple[str, str]) -> None:
    for text in documents:
        for name in (*SOLVERS, *FAMILIES):
            assert name in text


def test_the_page_is_well_formed_and_needs_no_other_file(documents: tuple[str, str]) -> None:
    page = Page(documents[1])
    assert not any(word in documents[1].lower() for word in ("http:", "https:", "url(", "@import", "src="))
    links = [value for _, name, value in page.attributes if name in ("href", "src")]
    targets = {value for _, name, value in page.attributes if name == "id"}
    assert links
    assert all(link.startswith("#") and link[1:] in targets for link in links)


def test_the_same_input_gives_the_same_bytes(documents: tuple[str, str], tmp_path: Path) -> None:
    assert written(tmp_path, drawn(), context()) == documents
