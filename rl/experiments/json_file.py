"""JSON files among the results: readable, whole or not at all."""

import json
from pathlib import Path
from typing import Any

from cpgrl_opt.comparison.whole_file import whole_file


def write_json(path: Path, contents: Any) -> None:
    """ValueError for what JSON does not have, NaN and infinities among it."""
    text = json.dumps(contents, indent=2, ensure_ascii=False, allow_nan=False)
    # In a command: a file name that the locale cannot read goes into the file as the bytes that it is.
    with whole_file(path) as beside:
        beside.write_text(text + "\n", encoding="utf-8", errors="surrogateescape")
