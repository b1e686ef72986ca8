"""Statements of the paper beside what was measured: a table to read, a file to compute with."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table


@dataclass(frozen=True)
class Claim:
    """One statement of the paper, and whether it came out.

    id: short name; claim: the paper's words; source: where they stand; measured: the numbers that decide, and the
    margin they are held against; evidence: the same in a few words; holds: the verdict.
    """

    id: str
    claim: str
    source: str
    measured: dict[str, float]
    evidence: str
    holds: bool

    def as_json(self) -> dict[str, Any]:
        """What `claims.json` holds of it."""
        return {
            "id": self.id,
            "claim": self.claim,
            "source": self.source,
            "measured": {name: float(value) for name, value in self.measured.items()},
            "holds": bool(self.holds),
        }


def write_claims(claims: Sequence[Claim], path: Path) -> None:
    """`claims.json`: a list of {"id", "claim", "source", "measured", "holds"}."""
    text = json.dumps([claim.as_json() for claim in claims], indent=2, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def print_claims(claims: Sequence[Claim], console: Console) -> None:
    """A row per claim, and how many hold."""
    table = Table("holds", "claim", "measured", title="Claims", title_justify="left", show_lines=True)
    for claim in claims:
        verdict = "[green]yes[/green]" if claim.holds else "[bold red]no[/bold red]"
        words, source, evidence = (escape(text) for text in (claim.claim, claim.source, claim.evidence))
        table.add_row(verdict, f"{words} [dim]({source})[/dim]", evidence)
    console.print(table)
    console.print(f"{sum(claim.holds for claim in claims)} of {len(claims)} claims hold.")
