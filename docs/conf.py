"""Sphinx: `sphinx-build -W docs OUT` makes the documentation of these pages; a warning is an error."""

import shutil
import sys
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
MEASURED = Path(__file__).parent / "measured"  # benchmarks/results, as pages of the site; git knows nothing of it
sys.path.insert(0, str(ROOT))

project, author, copyright = "cpgrl-opt", "The cpgrl-opt developers", "The cpgrl-opt developers"  # noqa: A001
version = release = installed_version("cpgrl-opt")
extensions = ["myst_parser", "sphinx.ext.autodoc"]
source_suffix = {".md": "markdown"}
html_theme, html_title, html_show_sphinx = "furo", f"cpgrl-opt {version}", False
html_static_path, html_css_files = ["_static"], ["docstrings.css"]
exclude_patterns = ["_build"]
myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # shapes stand in the text


def show_as_written(app: Any, what: str, name: str, about: Any, options: Any, lines: list[str]) -> None:
    """Docstrings are laid out by hand, formulas first: they come as they are."""
    if any(lines):
        lines[:] = [".. code-block:: text", "", *("   " + line for line in lines), ""]


def link_measurements(app: Any, page: str, text: list[str]) -> None:
    """Links to benchmarks/results lead to the pages made of it."""
    text[0] = text[0].replace("](../benchmarks/results/", "](measured/")


def setup(app: Any) -> None:
    """Called by Sphinx."""
    shutil.rmtree(MEASURED, ignore_errors=True)
    shutil.copytree(ROOT / "benchmarks/results", MEASURED, ignore=shutil.ignore_patterns("*.csv", "report.html"))
    app.connect("source-read", link_measurements)
    app.connect("autodoc-process-docstring", show_as_written)
