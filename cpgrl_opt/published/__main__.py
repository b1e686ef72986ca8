"""`python -m cpgrl_opt.published` writes the table method × law as Markdown to stdout."""

import sys

from .table import to_markdown

if __name__ == "__main__":
    sys.stdout.reconfigure(encoding="utf-8")  # type: ignore[union-attr]
    sys.stdout.write(to_markdown())
