"""The body of `cpgrl compare`: what is asked for, run, written and said."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

from ..solvers import SOLVERS
from .checkpoint import MEASUREMENTS, CellKey
from .contestants import DEFAULT_SOLVER, installed
from .families import FAMILIES
from .folder_lock import locked_folder
from .machine import machine, versions
from .measurement import Measurement
from .named_families import families_asked, family_named
from .runner import COMMON_PACKAGES, ComparisonSettings, Listen, open_checkpoint, run_comparison
from .table import as_table, count_cells, pandas
from .whole_file import whole_file

CELLS, REPORTS = "solvers.csv", ("report.md", "report.html")
PROBLEMS = 20
QUICK_PROBLEMS = 3
# One of each kind, without the slowest sizes and without those on which libraries are known to hang.
QUICK_FAMILIES = (
    "well-conditioned",
    "well-conditioned-bounds",
    "well-conditioned-equality",
    "well-conditioned-80x2",
    "opposing-1e-4",
    "opposing-1e-8",
    "duplicate",
    "sum-to-zero-equality",
    "row-scales-1e6",
    "gradients-1e-4",
    "cone-of-zero",
    "infeasible",
    "weakly-infeasible-1e-6",
)


@dataclass(frozen=True, kw_only=True)
class Request:
    """What the user typed: names, or None for all; problems None for as many as `quick` says."""

    solvers: Sequence[str] | None = None
    families: Sequence[str] | None = None
    problems: int | None = None
    seed: int = 0
    quick: bool = False

    def settings(self) -> tuple[ComparisonSettings, Mapping[str, str]]:
        """(what can be run, {solver that cannot: why}). ValueError for wrong names and numbers."""
        present, absent = installed(self.solvers or None)
        if not present:
            raise ValueError(f"solvers should have an installed one among them; found {', '.join(absent)}")
        standard = QUICK_FAMILIES if self.quick else tuple(FAMILIES)
        problems = (QUICK_PROBLEMS if self.quick else PROBLEMS) if self.problems is None else self.problems
        limits = {"repeats": 3, "limit": 2.0} if self.quick else {"repeats": 5, "limit": 5.0}
        settings = ComparisonSettings(
            solvers=present,
            families=tuple(families_asked(self.families or standard)),
            problems=problems,
            seed=self.seed,
            repeats=int(limits["repeats"]),
            limit=limits["limit"],
        )
        return settings, absent

    def folder(self) -> Path:
        """Where the results go unless the user says: a quick comparison has settings of its own, so its own place."""
        return Path("cpgrl-output") / ("compare-quick" if self.quick else "compare")

    def command(self) -> str:
        """What to type into a shell to get the same again."""
        chosen = {"solvers": self.solvers, "families": self.families}
        words = ["cpgrl compare", *(f"--{name} {quote(','.join(names))}" for name, names in chosen.items() if names)]
        words += [] if self.problems is None else [f"--problems {self.problems}"]
        words += ["--quick"] if self.quick else []
        return " ".join([*words, f"--seed {self.seed}"])


@dataclass(frozen=True)
class Comparison:
    """What came of it: measurements, {solver that could not be compared: why}, the files written.

    kept: cells in measurements.csv that were not asked for this time, and are not reported; renewed: cells that were
    there and are measured anew, since their key has changed.
    """

    measurements: Sequence[Measurement]
    absent: Mapping[str, str]
    files: Sequence[Path]
    kept: int = 0
    renewed: Sequence[CellKey] = ()


def compare(
    request: Request, folder: Path, *, jobs: int = 1, anew: bool = False, listen: Listen | None = None
) -> Comparison:
    """Runs what is not yet in `folder`, and writes measurements.csv, solvers.csv, report.md and report.html there.

    Reported is what the request asks for; measurements.csv keeps whatever else is finished there. Raises
    FolderInUseError where another process writes into the folder.
    """
    pandas()  # the report needs it: told now, and not after hours
    from .report import ReportContext, write_report

    settings, absent = request.settings()
    found = versions(dict.fromkeys((*COMMON_PACKAGES[1:], *map(_package, settings.solvers))))
    with locked_folder(folder):
        checkpoint = open_checkpoint(settings, folder, found, anew=anew)
        measurements = run_comparison(settings, checkpoint, jobs=jobs, listen=listen)
        with whole_file(folder / CELLS) as beside:
            count_cells(as_table(measurements)).to_csv(beside, index=False, lineterminator="\n")
        context = ReportContext(
            command=request.command(),
            machine=machine(),
            versions=found | {_package(name): why for name, why in absent.items()},
            settings=settings.describe(jobs),
            families={name: family_named(name).reason for name in settings.families},
            seed=settings.seed,
            wall_seconds=checkpoint.wall_seconds,
            default_solver=DEFAULT_SOLVER,
            ill_posed=[name for name in settings.families if not family_named(name).well_posed],
        )
        files = checkpoint.path, folder / CELLS, *write_report(measurements, context, folder)
    return Comparison(measurements, absent, files, len(checkpoint.kept), checkpoint.stale)


def _package(solver: str) -> str:
    package = getattr(SOLVERS.get(solver), "package", None)
    return package if package is not None else solver.partition(":")[0].partition(".")[0]


@contextmanager
def comparison_progress() -> Iterator[Listen]:
    """A progress bar on stderr while the context lasts, gone afterwards; silent where stderr is no terminal."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    words = TextColumn("cells"), TimeRemainingColumn(), TextColumn("{task.description}")
    columns = BarColumn(), MofNCompleteColumn(), *words
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task("starting", total=None)

        def listen(cell: CellKey, finished: int, total: int) -> None:
            bars.update(task, completed=finished, total=total, description=escape(" ".join(cell)))

        yield listen


def run_command(request: Request, folder: Path, *, jobs: int, anew: bool, say: Callable[[str], None]) -> None:
    """`cpgrl compare`: runs, writes, prints the main table; Ctrl-C and SIGTERM pass after saying what is kept."""
    from .report import print_summary

    try:
        with comparison_progress() as listen:
            done = compare(request, folder, jobs=jobs, anew=anew, listen=listen)
    except (KeyboardInterrupt, SystemExit):
        say(f"Interrupted. {folder / MEASUREMENTS} holds every finished cell; the same command goes on from there.")
        raise
    print_summary(done.measurements)
    for name, why in done.absent.items():
        say(f"{name} is {why}, so that it is not compared; see `cpgrl solvers`.")
    say(f"Wrote {', '.join(path.name for path in done.files)} into {folder}")
    if done.renewed:
        say(f"Measured anew, since what they were measured on has changed: {_cells_told(done.renewed)}.")
    if done.kept:
        say(f"{MEASUREMENTS} keeps what was finished before and not asked for now, unreported: cells: {done.kept}.")


def _cells_told(cells: Sequence[CellKey]) -> str:
    solvers = ", ".join(dict.fromkeys(solver for solver, _, _ in cells))
    return f"{len(cells)} cell{'s' if len(cells) > 1 else ''} of {solvers}"
