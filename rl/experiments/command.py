"""`cpgrl reproduce`: an experiment's settings as options, its progress, and what is said of its results."""

from collections.abc import Mapping
from dataclasses import fields
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from cpgrl_opt.validation import listed, require_nonnegative

from ..endings import in_one_line, telling_what_is_kept
from ..observers import ProgressBars
from ..standard_output import say
from ..training import DivergenceError
from .checkpoints import CheckpointError
from .claims import print_claims
from .experiment import Experiment
from .messages import Message
from .results_directory import UnusableDirectoryError
from .runner import Reproduction, carry_out, files_of, remarks, workplace
from .workers import WorkerDiedError


def options_of(experiment: type[Experiment]) -> list[Parameter]:
    """Those of its settings that the command has as options; lists are words with commas between them.

    Parameters
    ----------
    experiment
        Its class.

    Returns
    -------
    list of inspect.Parameter
        As typer reads them.
    """
    return [_option(own) for own in fields(experiment) if own.metadata]


def _option(own: Any) -> Parameter:
    default = ",".join(own.default) if isinstance(own.default, tuple) else own.default
    flag = f"--{own.name.replace('_', '-')}"  # alone: typer would add --no-… to a switch
    kind: Any = Annotated[type(default), typer.Option(flag, help=own.metadata["words"])]
    return Parameter(own.name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)


def settings_of(experiment: type[Experiment], options: Mapping[str, Any]) -> Experiment:
    """The experiment of the options, by their names; ValueError for wrong ones.

    Parameters
    ----------
    experiment
        Its class.
    options
        By the fields' names; lists are words with commas between them.

    Returns
    -------
    Experiment
        Of these settings.

    Raises
    ------
    ValueError
        For wrong ones.
    """
    lists = {own.name for own in fields(experiment) if isinstance(own.default, tuple)}
    given: dict[str, Any] = {name: listed(own) if name in lists else own for name, own in options.items()}
    return experiment(**given)


def run_experiment(
    settings: Experiment, out: Path, *, processes: int, checkpoint_every: float, anew: bool
) -> Reproduction:
    """Reproduces, with bars on the terminal, and says what came of it.

    Parameters
    ----------
    settings
        The experiment.
    out
        Directory of the results.
    processes, checkpoint_every, anew
        As `reproduce` says.

    Returns
    -------
    Reproduction
        Results and claims. Whatever the user can put right ends the command with one line.
    """
    with in_one_line(ValueError):
        require_nonnegative("checkpoint_every", checkpoint_every)
        import matplotlib  # noqa: F401 - refuses a wrong MPLBACKEND before a training rather than after it
    refusals = UnusableDirectoryError, CheckpointError, DivergenceError, WorkerDiedError
    with in_one_line(*refusals), workplace(settings, out, processes=processes, anew=anew) as place:
        if any(place.iterdir()):
            say(f"Going on where {place} was left; --anew starts over.", err=True)
        done = _carry_out_with_bars(settings, place, processes, checkpoint_every)
    print_claims(done.claims, Console())
    written = [name for name in files_of(settings) if (out / name).exists()]
    for line in (*remarks(done), f"Wrote {', '.join(written)} into {out}"):
        say(line)
    return done


def _carry_out_with_bars(settings: Experiment, place: Path, processes: int, checkpoint_every: float) -> Reproduction:
    """Whatever ends it early, what the disk holds is said."""

    def kept() -> str:
        is_there = any(place.iterdir())
        return f"{place} keeps what was trained; the same command goes on from there." if is_there else ""

    def listen(message: Message, least: int) -> None:
        bars.move(message.label, least)

    totals = {case.label: case.episodes for case in settings.cases()}
    try:
        with telling_what_is_kept(kept), ProgressBars(totals) as bars:
            return carry_out(settings, place, processes=processes, listen=listen, checkpoint_every=checkpoint_every)
    except Exception:
        if words := kept():
            say(words, err=True)
        raise
