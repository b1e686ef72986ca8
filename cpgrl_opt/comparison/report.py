"""The comparison as two documents for people: report.md, and report.html that needs no other file."""

from collections.abc import Sequence
from pathlib import Path

from .findings import find
from .measurement import AS_BYTES, Cell, Measurement
from .report_context import ReportContext
from .report_html import html_report
from .report_markdown import markdown_report
from .whole_file import whole_file

__all__ = ["ReportContext", "write_report"]


def write_report(
    cells: Sequence[Cell], measurements: Sequence[Measurement], context: ReportContext, folder: Path
) -> tuple[Path, Path]:
    """report.md and report.html in `folder`, which is made where missing; the same bytes for the same input."""
    findings = find(cells, measurements, context)
    folder.mkdir(parents=True, exist_ok=True)
    paths = folder / "report.md", folder / "report.html"
    for path, render in zip(paths, (markdown_report, html_report), strict=True):
        with whole_file(path) as beside:
            beside.write_text(render(findings), encoding="utf-8", errors=AS_BYTES, newline="\n")
    return paths
