"""The `cpgrl` command: one function a command, options declared once."""

from collections.abc import Callable
from importlib.metadata import version
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from cpgrl_opt.isolation.process_group import exit_on_termination
from cpgrl_opt.validation import listed, not_a_member, require_count

from .endings import FAILED, INTERRUPTED, in_one_line, refuse, telling_of_ctrl_c, telling_what_is_kept
from .interrupts import InterruptsHeld
from .standard_output import NOBODY_READS, say, standard_output


class ListedCommands(TyperGroup):
    """A group that answers a wrong name with the right ones."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that the first argument names."""
        if args and self.get_command(ctx, args[0]) is None:
            refuse(str(not_a_member(f"what follows {ctx.command_path}", args[0], self.list_commands(ctx))))
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """The command's; Ctrl-C where it does not look for it itself, as while it imports, is one line."""
        try:
            with telling_of_ctrl_c():
                return super().invoke(ctx)
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
        alone.command(cmd_name)(_reproduce(cmd_name))
        return typer.main.get_command(alone)


_SETTINGS: dict[str, Any] = {"no_args_is_help": True, "pretty_exceptions_enable": False}
app = typer.Typer(
    cls=ListedCommands, help="Constrained policy-gradient reinforcement learning.", add_completion=False, **_SETTINGS
)
app.add_typer(
    typer.Typer(cls=Experiments, help="Reproduce an experiment of the paper: claims, data, figures.", **_SETTINGS),
    name="reproduce",
)

Jobs = Annotated[int, typer.Option(help="Processes; 0 for one per core. The results do not depend on it.")]
Anew = Annotated[bool, typer.Option("--anew/--resume", help="Start over, or go on with what is in OUT.")]
Out = Annotated[Path, typer.Option(help="Directory of the results.")]
Seed = Annotated[int, typer.Option(help="The same seed draws the same problems.")]


def main() -> None:
    """The entry point of `cpgrl`."""
    with standard_output(), exit_on_termination(), telling_of_ctrl_c():
        app()


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
    from .experiments.solver_cases import print_solvers

    print_solvers()


@app.command()
def check(
    target: Annotated[str, typer.Argument(help="package.module:SOLVER, an instance, a class or a function (g, J, b).")],
    max_examples: Annotated[int, typer.Option(help="Problems that each law is put to.")] = 100,
    seed: Seed = 0,
    markdown: Annotated[Path | None, typer.Option(help="File for the verdict with all counterexamples.")] = None,
    expected_failure: Annotated[
        list[str] | None, typer.Option(metavar="CHECK=REASON", help="A law that is bound to break; repeatable.")
    ] = None,
    time_limit: Annotated[float, typer.Option(help="Seconds that one problem may take.")] = 30.0,
    memory_limit: Annotated[float, typer.Option(help="GiB that the solver's process may allocate.")] = 8.0,
) -> None:
    """Put a direction solver through the conformance kit: 0 all laws held, 1 one broke, 2 could not run."""
    with in_one_line(ImportError, ValueError):
        from cpgrl_opt.testing.command import run_check  # an extra; the message holds what to type

        settings = {"time_limit": time_limit, "memory_limit": memory_limit * 2**30, "markdown": markdown}
        expected = expected_failure or ()
        raise typer.Exit(
            run_check(target, max_examples=max_examples, seed=seed, expected_failures=expected, **settings)
        )


@app.command()
def export(
    recording: Annotated[Path, typer.Argument(help="subproblems.npz, as --record writes it.")],
    test_set: Annotated[Path, typer.Argument(help="Parquet file to write, a test set of qpbenchmark.")],
) -> None:
    """Write recorded direction problems as a test set of qpbenchmark."""
    from cpgrl_opt.comparison.export import export_recording
    from cpgrl_opt.comparison.recording import load_recording

    with in_one_line(ValueError):
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
    seed: Seed = 0,
    quick: Annotated[bool, typer.Option("--quick", help="Under a minute: fewer families and problems.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Default cpgrl-output/compare, or compare-quick with --quick.")
    ] = None,
    jobs: Jobs = 0,
    anew: Anew = False,
) -> None:
    """Every direction solver on families of problems: accuracy beside time, raw libraries beside ours."""
    from cpgrl_opt.comparison.command import Request, run_command
    from cpgrl_opt.comparison.table import ReportPackagesError

    with in_one_line(ValueError, ReportPackagesError):
        names = {"solvers": listed(solvers), "families": listed(families)}
        request = Request(**names, problems=problems, seed=seed, quick=quick)
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
    out: Out = Path("cpgrl-output/sweep"),
    engine: Annotated[str, typer.Option(help="loky, dask or ray. The table does not depend on it.")] = "loky",
    jobs: Jobs = 0,
    anew: Anew = False,
) -> None:
    """Train over settings and seeds into one table: 0 all ended well, 1 some did not, 2 could not run."""
    from .experiments.workers import WorkerDiedError
    from .sweeps.command import parse_seeds, run_sweep
    from .sweeps.engines import MissingEngineError

    kept = f"{out} keeps the trainings that ended; the same command goes on from there."
    with in_one_line(ValueError, MissingEngineError, WorkerDiedError), telling_what_is_kept(lambda: kept):
        asked: dict[str, Any] = {"every": every, "engine": engine, "jobs": _processes(jobs), "anew": anew}
        is_whole = run_sweep(target, over or [], out, seeds=parse_seeds(seeds), **asked)
    if not is_whole:
        raise typer.Exit(FAILED)


def _reproduce(name: str) -> Callable[..., None]:
    """The function behind `cpgrl reproduce NAME`: the experiment's settings as options, then those of every one."""
    with InterruptsHeld():
        from .experiments.checkpoints import EVERY
        from .experiments.command import options_of, run_experiment, settings_of
        from .experiments.registry import experiment_named

        experiment = experiment_named(name)

    def command(
        *,
        out: Out = Path("cpgrl-output") / name,
        strict: Annotated[bool, typer.Option("--strict", help="Exit with 1 when a claim fails.")] = False,
        jobs: Jobs = 0,
        checkpoint_every: Annotated[float, typer.Option(help="Seconds lost at most when it is killed.")] = EVERY,
        anew: Anew = False,
        **options: Any,
    ) -> None:
        with in_one_line(ValueError):
            settings, processes = settings_of(experiment, options), _processes(jobs)
        done = run_experiment(settings, out, processes=processes, checkpoint_every=checkpoint_every, anew=anew)
        if strict and not all(claim.holds for claim in done.claims):
            raise typer.Exit(FAILED)

    shared = [own for own in signature(command).parameters.values() if own.kind is Parameter.KEYWORD_ONLY]
    command.__signature__ = Signature([*options_of(experiment), *shared])  # type: ignore[attr-defined]
    command.__doc__ = experiment.about
    return command


def _processes(jobs: int) -> int:
    """How many: as many as this process may use cores, a container's limit among them, for 0."""
    require_count("jobs", jobs, 0)
    from joblib import cpu_count

    return jobs or int(cpu_count())


if __name__ == "__main__":
    main()
