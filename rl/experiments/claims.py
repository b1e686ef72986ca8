"""Statements of the paper beside what was measured: a table to read, a file to compute with."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from .json_file import write_json

# Whether a claim holds, the numbers that decide, and the margins they are held against.
Verdict = tuple[bool, Mapping[str, float]]
Judge = Callable[[Any], Verdict]  # of an experiment's evidence


@dataclass(frozen=True)
class Claim:
    """One statement of the paper, and whether it came out; an object of `claims.json`.

    id: short name; claim: the paper's words; source: where they stand; about: whose training it is judged by where the
    paper's word for it may mean more than one, else ""; measured: the numbers that decide, and the margins they are
    held against; holds: the verdict.
    """

    id: str
    claim: str
    source: str
    about: str
    measured: dict[str, float]
    holds: bool

    def in_words(self) -> str:
        """What was measured, by name."""
        return ", ".join(f"{name.replace('_', ' ')} {value:.4g}" for name, value in self.measured.items())


@dataclass(frozen=True)
class Statement:
    """A claim to be judged by evidence; needs: labels of the trainings without which it is left out."""

    id: str
    claim: str
    source: str
    find: Judge
    needs: tuple[str, ...] = ()
    about: str = ""

    def judge(self, evidence: Any) -> Claim:
        """The claim."""
        holds, measured = self.find(evidence)
        numbers = {name: float(value) for name, value in measured.items()}
        return Claim(self.id, self.claim, self.source, self.about, numbers, bool(holds))


class Statements(list[Statement]):
    """All that an experiment claims, in order, each added by a decorator of the function that judges it."""

    def add(self, name: str, claim: str, source: str, **more: Any) -> Callable[[Judge], Judge]:
        """A decorator; name: its id; see `Statement`."""

        def append(judge: Judge) -> Judge:
            self.append(Statement(name, claim, source, judge, **more))
            return judge

        return append

    def judge(self, evidence: Any) -> list[Claim]:
        """Those whose trainings are among the evidence's curves."""
        return [own.judge(evidence) for own in self if set(own.needs) <= set(evidence.curves)]


def write_claims(claims: Sequence[Claim], path: Path) -> None:
    """`claims.json`: a list of {"id", "claim", "source", "about" where it is told, "measured", "holds"}.

    Parameters
    ----------
    claims
        In their order.
    path
        Of the file.
    """
    written = [asdict(claim) for claim in claims]
    write_json(path, [{name: value for name, value in own.items() if value != ""} for own in written])


def print_claims(claims: Sequence[Claim], console: Console) -> None:
    """A row per claim, and how many hold.

    Parameters
    ----------
    claims
        In their order.
    console
        What prints them.
    """
    table = Table("holds", "claim", "measured", title="Claims", title_justify="left", show_lines=True)
    for claim in claims:
        verdict = "[green]yes[/green]" if claim.holds else "[bold red]no[/bold red]"
        where = f"{claim.source}; {claim.about}" if claim.about else claim.source
        table.add_row(verdict, f"{escape(claim.claim)} [dim]({escape(where)})[/dim]", escape(claim.in_words()))
    console.print(table)
    console.print(f"{sum(claim.holds for claim in claims)} of {len(claims)} claims hold.")
