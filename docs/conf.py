"""Sphinx: `sphinx-build -W docs OUT` makes the documentation of these pages; a warning is an error."""

import re
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
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
napoleon_google_docstring, napoleon_use_rtype = False, False
source_suffix = {".md": "markdown"}
html_theme, html_title, html_show_sphinx = "furo", f"cpgrl-opt {version}", False
html_static_path, html_css_files = ["_static"], ["docstrings.css"]
exclude_patterns = ["_build"]
myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # shapes stand in the text


def show_as_written(app: Any, what: str, name: str, about: Any, options: Any, lines: list[str]) -> None:
    """Docstrings are laid out by hand, formulas first, and come as they are, but for sections, which are napoleon's."""
    first = next((k for k in range(1, len(lines)) if lines[k] and not lines[k].strip("-")), len(lines) + 1) - 1
    text, sections = lines[:first], [re.sub(r"(?<!\\)([*|_])", r"\\\1", line) for line in lines[first:]]
    written = [".. code-block:: text", "", *("   " + line for line in text), ""] if any(text) else []
    lines[:] = [*written, *sections]


def link_measurements(app: Any, page: str, text: list[str]) -> None:
    """Links to benchmarks/results lead to the pages made of it."""
    text[0] = text[0].replace("](../benchmarks/results/", "](measured/")


def setup(app: Any) -> None:
    """Called by Sphinx."""
    shutil.rmtree(MEASURED, ignore_errors=True)
    shutil.copytree(ROOT / "benchmarks/results", MEASURED, ignore=shutil.ignore_patterns("*.csv", "report.html"))
    app.connect("source-read", link_measurements)
    app.connect("autodoc-process-docstring", show_as_written, priority=400)  # before napoleon, at 500
