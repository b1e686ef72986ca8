"""The `cpgrl` command."""

import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from importlib.metadata import version
from inspect import Parameter, Signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from cpgrl_opt.isolation.process_group import exit_on_termination
from cpgrl_opt.validation import require_count

from .interrupts import InterruptsHeld
from .standard_output import NOBODY_READS, WRONG_USE, say, standard_output

if TYPE_CHECKING:
    from .experiments.claims import Claim
    from .experiments.experiment import Experiment
    from .experiments.records import Advance
    from .observers import ProgressBars

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


class Experiments(ListedCommands):
    """A command for each experiment, made when it is asked for: they import what trains."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002 - there is one list
        """Their names."""
        from .experiments.registry import EXPERIMENTS

        return list(EXPERIMENTS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The experiment's of this name."""
        if cmd_name not in self.list_commands(ctx):
            return None
        alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        alone.command(cmd_name)(_command(cmd_name))
        return typer.main.get_command(alone)


_SETTINGS: dict[str, Any] = {"cls": ListedCommands, "no_args_is_help": True, "pretty_exceptions_enable": False}
app = typer.Typer(help="Constrained policy-gradient reinforcement learning.", add_completion=False, **_SETTINGS)
reproduce = typer.Typer(
    help="Reproduce an experiment of the paper: claims, data, figures.", **{**_SETTINGS, "cls": Experiments}
)
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
    memory_limit: Annotated[float, typer.Option(help="GiB that the solver's process may allocate.")] = 8.0,
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
                memory_limit=memory_limit * 2**30,
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


@app.command()
def sweep(
    target: Annotated[str, typer.Argument(help="three-state, arm, or package.module:FUNCTION (settings, seed).")],
    over: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE,VALUE", help="A setting with its values; repeatable.")
    ] = None,
    seeds: Annotated[str, typer.Option(help="How many, or which: 3,5,8.")] = "5",
    every: Annotated[int, typer.Option(help="Episodes between two records of a training.")] = 100,
    out: Annotated[Path, typer.Option(help="Directory of the results.")] = Path("cpgrl-output/sweep"),
    engine: Annotated[str, typer.Option(help="loky, dask or ray. The table does not depend on it.")] = "loky",
    jobs: Annotated[int, typer.Option(help="Processes; 0 for one per core. The table does not depend on it.")] = 0,
    anew: Annotated[bool, typer.Option("--anew/--resume", help="Start over, or keep the trainings in OUT.")] = False,
) -> None:
    """Train over settings and seeds into one table: 0 all ended well, 1 some did not, 2 could not run."""
    from .sweeps.command import parse_seeds, run_sweep
    from .sweeps.engines import MissingEngineError

    with _clean_errors(ValueError, MissingEngineError):
        kept = f"{out} keeps the trainings that ended; the same command goes on from there."
        with _tell_when_interrupted(lambda: kept):
            found, files = run_sweep(
                target, over or [], out, seeds=parse_seeds(seeds), every=every, engine=engine, jobs=_processes(jobs),
                anew=anew,
            )  # fmt: skip
    say(f"Trained {found.trained}, of which {len(found.failed)} ended with an error.")
    say(f"Wrote {', '.join(files)} into {out}")
    for row in found.failed[:3]:
        settings = ", ".join(f"{name} {row[name]}" for name in found.columns[: found.columns.index("run")])
        say(f"{settings}: {row['error']} (after episode {row['episode']})", err=True)
    if found.failed:
        raise typer.Exit(FAILED_CLAIM)


def _names(listed: str) -> list[str]:
    return [name.strip() for name in listed.split(",") if name.strip()]


def _command(name: str) -> Callable[..., None]:
    """The function behind `cpgrl reproduce NAME`: the experiment's settings as options, then those of every one."""
    with InterruptsHeld():
        from .experiments.checkpoints import EVERY
        from .experiments.registry import experiment_named

        experiment = experiment_named(name)

    def command(out: Path, strict: bool, jobs: int, checkpoint_every: float, anew: bool, **settings: Any) -> None:
        lists = {own.name for own in fields(experiment) if isinstance(own.default, tuple)}
        chosen = {own: _names(value) if own in lists else value for own, value in settings.items()}
        _reproduce(experiment, chosen, out, strict=strict, jobs=jobs, checkpoint_every=checkpoint_every, anew=anew)

    options = [*map(_option, (own for own in fields(experiment) if own.metadata))]
    options += [
        _parameter("out", Path("cpgrl-output") / name, "Directory of the results."),
        _parameter("strict", False, "Exit with 1 when a claim fails.", "--strict"),
        _parameter("jobs", 0, "Processes; 0 for one per core. The results do not depend on it."),
        _parameter(
            "checkpoint_every", EVERY, "Seconds between two checkpoints: what is lost at most when it is killed."
        ),
        _parameter("anew", False, "Start over, or go on where it was stopped.", "--anew/--resume"),
    ]
    command.__signature__ = Signature(options)  # type: ignore[attr-defined]
    command.__annotations__ = {}
    command.__doc__ = experiment.about
    return command


def _option(own: Any) -> Parameter:
    """Of a setting; lists are words with commas between them."""
    default = ",".join(own.default) if isinstance(own.default, tuple) else own.default
    names = own.metadata["names"]
    if isinstance(default, bool):
        names = (f"--{own.name.replace('_', '-')}",)
    elif names:
        names = (f"--{own.name.replace('_', '-')}", *names)
    return _parameter(own.name, default, own.metadata["words"], *names)


def _parameter(name: str, default: Any, words: str, *names: str) -> Parameter:
    kind = Path if isinstance(default, Path) else type(default)
    declared = typer.Option(default, *names, help=words)
    return Parameter(name, Parameter.KEYWORD_ONLY, default=declared, annotation=kind)


def _reproduce(
    experiment: "type[Experiment]", chosen: Mapping[str, Any], out: Path, *, strict: bool, jobs: int,
    checkpoint_every: float, anew: bool,
) -> None:  # fmt: skip
    from .experiments import runner
    from .experiments.checkpoints import require_interval
    from .observers import ProgressBars

    with _clean_errors(ValueError):
        processes = _processes(jobs)
        require_interval(checkpoint_every)
        import matplotlib  # noqa: F401 - refuses a wrong MPLBACKEND before a training rather than after it

        settings = experiment(**chosen)
        totals = {case.label: case.episodes for case in settings.cases()}
    files = runner.files_of(experiment)
    with _reserve(out):
        place = _place(out, files, runner.key_of(settings), anew=anew)
        recorded: dict[str, int] = {}
        with ProgressBars(totals) as bars, _telling_what_is_kept(bars, recorded, place, out):

            def listen(advance: "Advance") -> None:
                if advance.recorded:
                    recorded[advance.label] = advance.episode
                bars.move(advance.label, advance.episode)

            done = runner.reproduce(
                settings, out, processes=processes, listen=listen, checkpoint_every=checkpoint_every
            )
        written = [name for name in files if (out / name).exists()]
    for comparison, table in done.tables:
        comparison.show(table)
    _report(done.claims, runner.remarks(done), written, out, strict=strict)


@contextmanager
def _reserve(out: Path) -> Iterator[None]:
    """The directory for this command alone, one line where it cannot be had."""
    from .experiments.results_directory import UnusableDirectoryError, reserve

    with ExitStack() as stack:
        with _clean_errors(UnusableDirectoryError):
            stack.enter_context(reserve(out))
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
def _telling_what_is_kept(bars: "ProgressBars", recorded: Mapping[str, int], place: Path, out: Path) -> Iterator[None]:
    """Whatever ends a training early, what the disk holds is said; of what is no bug of ours, one line."""
    with _clean_errors(), _tell_when_interrupted(lambda: _kept(recorded, place, out)):
        try:
            yield
        except BaseException as error:
            bars.stop()
            if recorded and isinstance(error, Exception):
                say(_kept(recorded, place, out), err=True)
            raise


@contextmanager
def _tell_when_interrupted(kept: Callable[[], str]) -> Iterator[None]:
    """After Ctrl-C, SIGTERM and SIGHUP one line, and an exit with 128 + the signal's number."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit) as end:
        code = INTERRUPTED if isinstance(end, KeyboardInterrupt) else end.code
        if code not in (INTERRUPTED, *TERMINATED):
            raise
        say(f"Interrupted. {kept()}", err=True)
        raise typer.Exit(int(code)) from None


def _kept(recorded: Mapping[str, int], place: Path, out: Path) -> str:
    reached = [f"{label} to episode {episode}" for label, episode in recorded.items()]
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
def _clean_errors(*refusals: type[Exception]) -> Iterator[None]:
    """One line instead of a traceback for whatever the user can put right, these refusals of what was typed too.

    Any ValueError is a refusal only where nothing but input is looked at: elsewhere it would be a bug of ours.
    """
    from cpgrl_opt import MissingPackageError
    from cpgrl_opt.comparison.table import ReportPackagesError

    from .experiments.checkpoints import CheckpointError
    from .experiments.workers import WorkerDiedError
    from .training import DivergenceError

    no_bugs = MissingPackageError, ReportPackagesError, CheckpointError, DivergenceError, WorkerDiedError, OSError
    told: tuple[type[Exception], ...] = (*no_bugs, *refusals)
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
