"""The `cpgrl` command."""

import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from cpgrl_opt.comparison.process_group import exit_on_termination
from cpgrl_opt.validation import require_count

from .interrupts import InterruptsHeld
from .standard_output import NOBODY_READS, WRONG_USE, say, standard_output

if TYPE_CHECKING:
    from .experiments.claims import Claim
    from .experiments.progress import TrainingProgress
    from .experiments.three_state_comparison import ComparisonSettings

FAILED_CLAIM, INTERRUPTED, TERMINATED = 1, 130, (129, 143)


class ListedCommands(TyperGroup):
    """A group that answers a wrong name with the right ones."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that the first argument names."""
        if args and self.get_command(ctx, args[0]) is None:
            names = ", ".join(self.list_commands(ctx))
            _refuse(f"{ctx.command_path} should be followed by one of {names}; found {args[0]!r}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """The command's; Ctrl-C where it does not look for it itself, as while it imports, is one line."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            _tell_interrupted()
            raise typer.Exit(INTERRUPTED) from None
        except BrokenPipeError:  # of standard output: whoever writes to another pipe looks for it
            raise typer.Exit(NOBODY_READS) from None


_SETTINGS: dict[str, Any] = {"cls": ListedCommands, "no_args_is_help": True, "pretty_exceptions_enable": False}
app = typer.Typer(help="Constrained policy-gradient reinforcement learning.", add_completion=False, **_SETTINGS)
reproduce = typer.Typer(help="Reproduce an experiment of the paper: claims, data, figures.", **_SETTINGS)
app.add_typer(reproduce, name="reproduce")


def main() -> None:
    """The entry point of `cpgrl`."""
    with standard_output(), exit_on_termination():
        try:
            app()
        except KeyboardInterrupt:  # before typer looks for it
            _tell_interrupted()
            sys.exit(INTERRUPTED)


def _tell_interrupted() -> None:
    say("Interrupted.", err=True)


def _print_version(wanted: bool) -> None:
    if wanted:
        say(f"cpgrl {version('cpgrl-opt')}")
        raise typer.Exit


@app.callback()
def _cpgrl(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command()
def solvers() -> None:
    """List the direction solvers: what is installed, what each takes and guarantees."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from cpgrl_opt import SOLVERS
    from cpgrl_opt.solvers import obstacle

    from .experiments.solver_cases import cases

    table = Table("solver", "installed", "formulations", "guarantee", "source")
    for name, solver in SOLVERS.items():
        why_not = obstacle(solver).replace("not installed", "no")
        installed = f"[red]{escape(why_not)}[/red]" if why_not else "[green]yes[/green]"
        facts = (getattr(solver, fact, "") for fact in ("guarantee", "source"))
        table.add_row(f"[bold]{name}[/bold]", installed, ", ".join(cases(solver)), *facts)
    Console().print(table)


@app.command()
def check(
    target: Annotated[str, typer.Argument(help="package.module:SOLVER, an instance, a class or a function (g, J, b).")],
    max_examples: Annotated[int, typer.Option(help="Problems that each law is put to.")] = 100,
    seed: Annotated[int, typer.Option(help="The same seed draws the same problems.")] = 0,
    markdown: Annotated[Path | None, typer.Option(help="File for the verdict with all counterexamples.")] = None,
    expected_failure: Annotated[
        list[str] | None, typer.Option(metavar="CHECK=REASON", help="A law that is bound to break; repeatable.")
    ] = None,
    time_limit: Annotated[float, typer.Option(help="Seconds that one problem may take.")] = 30.0,
) -> None:
    """Put a direction solver through the conformance kit: 0 all laws held, 1 one broke, 2 could not run."""
    try:
        from cpgrl_opt.testing.command import run_check
    except ImportError as error:  # the kit's own extra; the message holds what to type
        _refuse(str(error))
    with _clean_errors(ValueError):
        raise typer.Exit(
            run_check(
                target, max_examples=max_examples, seed=seed, markdown=markdown,
                expected_failures=expected_failure or (), time_limit=time_limit,
            )
        )  # fmt: skip


@app.command()
def export(
    recording: Annotated[Path, typer.Argument(help="subproblems.npz, as --record writes it.")],
    test_set: Annotated[Path, typer.Argument(help="Parquet file to write, a test set of qpbenchmark.")],
) -> None:
    """Write recorded direction problems as a test set of qpbenchmark."""
    from cpgrl_opt.comparison.export import export_recording
    from cpgrl_opt.comparison.recording import load_recording

    with _clean_errors(ValueError):
        recorded = load_recording(recording)
        export_recording(recorded, test_set)
    say(f"Wrote {len(recorded)} problems into {test_set}")


@app.command()
def compare(
    solvers: Annotated[str, typer.Option(help="Of `cpgrl solvers`, or package.module:SOLVER; default all.")] = "",
    families: Annotated[
        str, typer.Option(help="Of problems, * for many, or FILE.npz that --record wrote; default all.")
    ] = "",
    problems: Annotated[int | None, typer.Option(help="Problems of each family: 20, or 3 with --quick.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the problems.")] = 0,
    quick: Annotated[bool, typer.Option("--quick", help="Under a minute: fewer families and problems.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Default cpgrl-output/compare, or compare-quick with --quick.")
    ] = None,
    jobs: Annotated[int, typer.Option(help="Processes; 0 for one per core.")] = 0,
    anew: Annotated[bool, typer.Option("--anew/--resume", help="Start over, or keep the cells in OUT.")] = False,
) -> None:
    """Every direction solver on families of problems: accuracy beside time, raw libraries beside ours."""
    from cpgrl_opt.comparison.command import Request, run_command

    with _clean_errors(ValueError):
        request = Request(
            solvers=_names(solvers), families=_names(families), problems=problems, seed=seed, quick=quick
        )  # fmt: skip
        try:
            folder = request.folder() if out is None else out
            run_command(request, folder, jobs=_processes(jobs), anew=anew, say=lambda text: say(text, err=True))
        except KeyboardInterrupt:
            raise typer.Exit(INTERRUPTED) from None


def _names(listed: str) -> list[str]:
    return [name.strip() for name in listed.split(",") if name.strip()]


@reproduce.command("three-state")
def three_state(
    runs: Annotated[int, typer.Option(help="Independent runs of each method.")] = 20,
    episodes: Annotated[int, typer.Option(help="Episodes of a run; an update follows each.")] = 10_000,
    steps: Annotated[int, typer.Option(help="Environment steps of an episode.")] = 100,
    seed: Annotated[int, typer.Option(help="Seed of all random streams.")] = 0,
    solver: Annotated[str, typer.Option(help="CPGRL's direction solver; `cpgrl solvers` lists them.")] = "rosen",
    formulation: Annotated[
        str, typer.Option(help="Of the subproblem: equality, cone, restoring, linearized.")
    ] = "equality",
    record_every: Annotated[int, typer.Option(help="Episodes between two rows of a run in learning.csv.")] = 100,
    record: Annotated[
        int, typer.Option(help="Direction problems to keep in subproblems.npz; 0 for none.", metavar="N")
    ] = 0,
    out: Annotated[Path, typer.Option(help="Directory of the results.")] = Path("cpgrl-output/three-state"),
    strict: Annotated[bool, typer.Option("--strict", help="Exit with 1 when a claim fails.")] = False,
    jobs: Annotated[int, typer.Option(help="Processes; 0 for one per core. The results do not depend on it.")] = 0,
    checkpoint_every: Annotated[
        float, typer.Option(help="Seconds between two checkpoints: what is lost at most when it is killed.")
    ] = 10.0,
    anew: Annotated[bool, typer.Option("--anew/--resume", help="Start over, or go on where it was stopped.")] = False,
    compare: Annotated[
        bool, typer.Option("--compare", help="Train CPGRL under other solvers, formulations and drop rules too.")
    ] = False,
    compare_solvers: Annotated[str, typer.Option(help="Of --compare; five if empty; or `all`.")] = "",
    compare_formulations: Annotated[str, typer.Option(help="Of --compare.")] = "equality,cone,restoring,linearized",
    compare_episodes: Annotated[int, typer.Option(help="Of --compare, where a solver is not compiled.")] = 500,
) -> None:
    """CPGRL, CONB and SUM on the three-state MDP: §3 of the paper, Fig. 4 and 5."""
    with InterruptsHeld():
        from .experiments.checkpoints import require_interval
        from .experiments.progress import training_progress
        from .experiments.three_state import METHODS, ThreeStateSettings
        from .experiments.three_state_comparison import ComparisonSettings
        from .experiments.three_state_reproduction import FILES, key_of, remarks, reproduce_three_state

    with _clean_errors(ValueError):
        processes = _processes(jobs)
        require_interval(checkpoint_every)
        settings = ThreeStateSettings(
            runs=runs, episodes=episodes, steps=steps, seed=seed,
            solver=solver, formulation=formulation, record_every=record_every, record=record,
        )  # fmt: skip
        comparison = None if not compare else ComparisonSettings(
            training=settings, solvers=_listed(compare_solvers), formulations=_listed(compare_formulations),
            slow_episodes=compare_episodes,
        )  # fmt: skip
    with _reserved(out):
        place = _place(out, FILES, key_of(settings), anew=anew)
        with training_progress(METHODS, episodes) as progress, _telling_what_is_kept(progress, place, out):
            done = reproduce_three_state(
                settings, out, processes=processes, listen=progress.listen, checkpoint_every=checkpoint_every
            )
        if comparison is not None:
            _compare(comparison, out, processes)
        written = [name for name in FILES if (out / name).exists()]
    _report(done.claims, remarks(done), written, out, strict=strict)


@reproduce.command("arm")
def arm(
    runs: Annotated[int, typer.Option(help="Independent runs of each condition.")] = 20,
    episodes: Annotated[int, typer.Option(help="Episodes of a run; an update follows each.")] = 10_000,
    seed: Annotated[int, typer.Option(help="Seed of all random streams.")] = 0,
    solver: Annotated[str, typer.Option(help="CPGRL's direction solver; `cpgrl solvers` lists them.")] = "rosen",
    formulation: Annotated[
        str, typer.Option(help="Of the subproblem: equality, cone, restoring, linearized.")
    ] = "equality",
    estimator: Annotated[str, typer.Option(help="Of the gradients: konda, gpomdp.")] = "konda",
    conditions: Annotated[
        str, typer.Option(help="a, b, c of the paper; c-episode, c-feasible, c-no-projection beside them.")
    ] = "a,b,c,c-episode,c-feasible,c-no-projection",
    record_every: Annotated[
        int, typer.Option("--record-every", "--block", help="Episodes of a block, a row of a run in learning.csv.")
    ] = 100,
    record: Annotated[
        int,
        typer.Option(
            help="Direction problems to keep in subproblems.npz, of each constrained training; 0 for none.", metavar="N"
        ),
    ] = 0,
    out: Annotated[Path, typer.Option(help="Directory of the results.")] = Path("cpgrl-output/arm"),
    strict: Annotated[bool, typer.Option("--strict", help="Exit with 1 when a claim fails.")] = False,
    jobs: Annotated[int, typer.Option(help="Processes; 0 for one per core. The results do not depend on it.")] = 0,
    checkpoint_every: Annotated[
        float, typer.Option(help="Seconds between two checkpoints: what is lost at most when it is killed.")
    ] = 10.0,
    anew: Annotated[bool, typer.Option("--anew/--resume", help="Start over, or go on where it was stopped.")] = False,
    compare: Annotated[
        bool, typer.Option("--compare", help="Train (b) and (c) under every formulation too: compare.csv, compare.md.")
    ] = False,
) -> None:
    """The two-link arm with and without constraints: §4 of the paper, Fig. 6 and 7."""
    with InterruptsHeld():
        from .experiments.checkpoints import require_interval
        from .experiments.progress import training_progress
        from .experiments.two_link_arm import ArmSettings
        from .experiments.two_link_arm_comparison import print_comparison
        from .experiments.two_link_arm_reproduction import FILES, key_of, remarks, reproduce_two_link_arm

    with _clean_errors(ValueError):
        processes = _processes(jobs)
        require_interval(checkpoint_every)
        settings = ArmSettings(
            runs=runs, episodes=episodes, seed=seed, solver=solver, formulation=formulation, estimator=estimator,
            conditions=[name.strip() for name in conditions.split(",")], record_every=record_every, compare=compare,
            record=record,
        )  # fmt: skip
    labels = [case.label for case in settings.cases()]
    with _reserved(out):
        place = _place(out, FILES, key_of(settings), anew=anew)
        with training_progress(labels, episodes) as progress, _telling_what_is_kept(progress, place, out):
            done = reproduce_two_link_arm(
                settings, out, processes=processes, listen=progress.listen, checkpoint_every=checkpoint_every
            )
        written = [name for name in FILES if (out / name).exists()]
    if done.comparison:
        print_comparison(done.comparison, done.results.arm)
    _report(done.claims, remarks(done), written, out, strict=strict)


def _compare(settings: "ComparisonSettings", out: Path, processes: int) -> None:
    from .experiments.progress import training_progress
    from .experiments.three_state_reproduction import compare_in

    answered = _signals_answered(lambda: f"{out} holds the reproduction, without the comparison.")
    with answered, _clean_errors(), training_progress(["comparison"], settings.updates) as progress:
        compare_in(out, settings, processes=processes, listen=progress.listen)


def _listed(names: str) -> list[str]:
    return [name.strip() for name in names.split(",") if name.strip()]


@contextmanager
def _reserved(out: Path) -> Iterator[None]:
    """The directory for this command alone, one line where it cannot be had."""
    from .experiments.results_directory import UnusableDirectoryError, reserved

    with ExitStack() as stack:
        with _clean_errors(UnusableDirectoryError):
            stack.enter_context(reserved(out))
        yield


def _place(out: Path, files: Sequence[str], key: Mapping[str, Any], *, anew: bool) -> Path:
    """Where the experiment writes; one line if it goes on there."""
    from .experiments.checkpoints import forget, holds
    from .experiments.results_directory import place_for

    place = place_for(out, files, key)
    if holds(place, key) and anew:
        forget(place)
        return place_for(out, files, key)
    if holds(place, key):
        say(f"Going on where {place} was left; --anew starts over.", err=True)
    return place


@contextmanager
def _telling_what_is_kept(progress: "TrainingProgress", place: Path, out: Path) -> Iterator[None]:
    """Whatever ends a training early, what the disk holds is said; of what is no bug of ours, one line."""
    with _signals_answered(lambda: _kept(progress, place, out)), _clean_errors():
        try:
            yield
        except Exception:
            progress.stop()
            if progress.recorded:
                say(_kept(progress, place, out), err=True)
            raise


@contextmanager
def _signals_answered(tell: Callable[[], str]) -> Iterator[None]:
    """Ctrl-C, SIGTERM and SIGHUP: one line with what is kept, and 128 + the signal's number to exit with."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit) as end:
        code = INTERRUPTED if isinstance(end, KeyboardInterrupt) else end.code
        if code not in (INTERRUPTED, *TERMINATED):
            raise
        say(f"Interrupted. {tell()}", err=True)
        raise typer.Exit(int(code)) from None


def _kept(progress: "TrainingProgress", place: Path, out: Path) -> str:
    progress.stop()
    reached = [f"{label} to episode {episode}" for label, episode in progress.recorded.items()]
    held = f"{place / 'learning.csv'} holds {', '.join(reached)}." if reached else "No episode was recorded."
    if reached:
        held = f"{held} The same command goes on from there, or a few seconds before."
    return held if place == out else f"{held} The earlier results in {out} are as they were."


def _report(
    claims: "Sequence[Claim]", remarks: Sequence[str], files: Sequence[str], out: Path, *, strict: bool
) -> None:
    from rich.console import Console

    from .experiments.claims import print_claims

    print_claims(claims, Console())
    for remark in remarks:
        say(remark)
    say(f"Wrote {', '.join(files)} into {out}")
    if strict and not all(claim.holds for claim in claims):
        raise typer.Exit(FAILED_CLAIM)


def _processes(jobs: int) -> int:
    require_count("jobs", jobs, 0)
    if jobs:
        return jobs
    usable = getattr(os, "sched_getaffinity", None)  # a container may be given fewer cores than the machine has
    return len(usable(0)) if usable else os.cpu_count() or 1


@contextmanager
def _clean_errors(*refusals: type[ValueError]) -> Iterator[None]:
    """One line instead of a traceback for whatever the user can put right, these refusals of what was typed too.

    Any ValueError is a refusal only where nothing but input is looked at: elsewhere it would be a bug of ours.
    """
    from cpgrl_opt import MissingPackageError
    from cpgrl_opt.comparison.table import ReportPackagesError

    from .experiments.checkpoints import CheckpointError
    from .experiments.workers import WorkerDiedError
    from .training import DivergenceError

    missing = MissingPackageError, ReportPackagesError
    told: tuple[type[Exception], ...] = (
        *missing,
        CheckpointError,
        DivergenceError,
        WorkerDiedError,
        OSError,
        *refusals,
    )
    try:
        yield
    except BrokenPipeError:
        raise
    except MemoryError as error:
        _refuse(f"this needs more memory than there is; fewer runs or shorter episodes need less ({error})")
    except told as error:
        _refuse(str(error))


def _refuse(message: str) -> NoReturn:
    say(f"cpgrl: {message}", err=True)
    sys.exit(WRONG_USE)


if __name__ == "__main__":
    main()
