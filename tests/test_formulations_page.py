"""docs/formulations.md: its formulations are those of the code, and its numbers those of the benchmark."""

from pathlib import Path

from cpgrl_opt import FORMULATIONS

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/formulations.md").read_text(encoding="utf-8")
RESULTS = ROOT / "benchmarks/results/violations_on_the_way.md"


def table(text, columns):
    """Headings and rows of the table whose headings begin with these."""
    (found,) = [part for part in text.split("\n\n") if part.startswith("| " + " | ".join(columns))]
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in found.splitlines()]
    return lines[0], lines[2:]


def test_the_formulations_are_those_of_the_code():
    _, rows = table(PAGE, ["name"])
    assert [row[0].strip("`") for row in rows] == list(FORMULATIONS)


def test_the_numbers_are_those_that_the_benchmark_wrote():
    _, shown = table(PAGE, ["task", "formulation"])
    titles, measured = table(RESULTS.read_text(encoding="utf-8"), ["task", "method"])
    chosen = [titles.index(name) for name in ("task", "method", "by > 1 %, %", "largest, %", "return")]
    assert shown == [[row[k] for k in chosen] for row in measured]
