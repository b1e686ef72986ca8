"""Statements of the paper beside what was measured: a table to read, a file to compute with."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table


@dataclass(frozen=True)
class Claim:
    """One statement of the paper, and whether it came out.

    id: short name; claim: the paper's words; source: where they stand; measured: the numbers that decide, and the
    margin they are held against; evidence: the same in a few words; holds: the verdict; about: whose training it is
    judged by where the paper's word for it may mean more than one, else "".
    """

    id: str
    claim: str
    source: str
    measured: dict[str, float]
    evidence: str
    holds: bool
    about: str = ""

    def as_json(self) -> dict[str, Any]:
        """What `claims.json` holds of it."""
        return {
            "id": self.id,
            "claim": self.claim,
            "source": self.source,
            **({"about": self.about} if self.about else {}),
            "measured": {name: float(value) for name, value in self.measured.items()},
            "holds": bool(self.holds),
        }


# What decides, in words, and whether it holds.
Verdict = tuple[bool, dict[str, float], str]


@dataclass(frozen=True)
class Statement:
    """A claim to be judged by evidence; needs: labels of the trainings without which it is left out."""

    id: str
    claim: str
    source: str
    judge: Callable[..., Verdict]
    needs: tuple[str, ...] = ()
    about: str = ""

    def judged(self, evidence: Any) -> Claim:
        """The claim."""
        holds, measured, words = self.judge(evidence)
        return Claim(self.id, self.claim, self.source, measured, words, holds, self.about)


@dataclass(frozen=True)
class Statements:
    """All that an experiment claims, in order, each added by a decorator of the function that judges it."""

    all: list[Statement] = field(default_factory=list)

    def add(self, name: str, claim: str, source: str, **more: Any) -> Callable[[Callable[..., Verdict]], Any]:
        """A decorator; name: its id; see `Statement`."""

        def added(judge: Callable[..., Verdict]) -> Callable[..., Verdict]:
            self.all.append(Statement(name, claim, source, judge, **more))
            return judge

        return added

    def judged(self, evidence: Any) -> list[Claim]:
        """Those whose trainings are among the evidence's curves."""
        return [own.judged(evidence) for own in self.all if set(own.needs) <= set(evidence.curves)]


def write_claims(claims: Sequence[Claim], path: Path) -> None:
    """`claims.json`: a list of {"id", "claim", "source", "measured", "holds"}."""
    text = json.dumps([claim.as_json() for claim in claims], indent=2, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def print_claims(claims: Sequence[Claim], console: Console) -> None:
    """A row per claim, and how many hold."""
    table = Table("holds", "claim", "measured", title="Claims", title_justify="left", show_lines=True)
    for claim in claims:
        verdict = "[green]yes[/green]" if claim.holds else "[bold red]no[/bold red]"
        where = f"{claim.source}; {claim.about}" if claim.about else claim.source
        words, source, evidence = (escape(text) for text in (claim.claim, where, claim.evidence))
        table.add_row(verdict, f"{words} [dim]({source})[/dim]", evidence)
    console.print(table)
    console.print(f"{sum(claim.holds for claim in claims)} of {len(claims)} claims hold.")
