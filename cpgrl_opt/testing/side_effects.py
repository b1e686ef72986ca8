"""Laws of conduct: bad input is refused, input stays as it is, answers repeat, nothing is printed."""

import ctypes
import io
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress

import numpy as np

from ..direction import Status
from ..problem import DirectionProblem
from ..solvers.interface import DirectionSolver
from .law import (
    LawError,
    NothingClaimed,
    answer_of,
    law,
    read_answer,
    require,
    same_bits,
    skip_unless,
    takes,
    vary,
)

_ARRAYS = ("gradient", "jacobian", "bound", "equality", "metric")


@law
def check_non_finite_is_refused(
    solver: DirectionSolver, problem: DirectionProblem, where: str = "gradient", value: float = float("nan")
) -> None:
    """NaN or an infinity in g, J or b that got past validation: ValueError, or a status that claims nothing.

    where: "gradient", "jacobian" or "bound"; value: NaN, inf or −inf (−inf in b is valid and skipped).
    Source: comparisons with NaN are false, so a violated constraint looks met; IEEE 754 §5.11.
    """
    array = getattr(problem, where)
    skip_unless(takes(solver, problem) and array.size > 0 and not (where == "bound" and value == -np.inf))
    forged = writable_copy(problem)
    getattr(forged, where).flat[0] = value
    try:
        status = read_answer(problem, solver.solve(forged)).status
    except ValueError:
        return
    except LawError:
        raise
    except Exception as error:
        raise LawError(
            f"{value} in {where} should raise ValueError; found {type(error).__name__}: {error}", forged
        ) from error
    message = (
        f"{value} in {where} should raise ValueError; found the status {status.name}. Check the input for what is not "
        "finite, or let kkt_residuals judge the answer"
    )
    require(status not in (Status.OPTIMAL, Status.INFEASIBLE), message, forged)


@law
def check_input_is_unchanged(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """g, J, b, E and M are bit for bit the same after solving, even where the arrays are writable.

    Source: the caller's next subproblem shares these arrays.
    """
    given = writable_copy(problem)
    answer_of(solver, given)
    for name in _ARRAYS:
        before, after = getattr(problem, name), getattr(given, name)
        if before is not None and before.tobytes() != after.tobytes():
            raise LawError(
                f"solve should leave problem.{name} as it is; found {after.tolist()} where {before.tolist()} was. "
                "Work on a copy",
                problem,
            )


@law
def check_answers_repeat(solver: DirectionSolver, problem: DirectionProblem, between: DirectionProblem) -> None:
    """The same problem gives the same answer bit for bit, whatever was solved in between: no hidden state.

    It is solved once more before, so that what broke the law is in these two problems alone.
    Source: a function; reproducible training needs it.
    """
    answer_of(solver, problem)
    first = answer_of(solver, problem)
    with suppress(NothingClaimed):
        answer_of(solver, between)
    again = answer_of(solver, problem)
    message = (
        "the same problem should give the same answer after another one was solved in between; found two. Warm starts, "
        "active sets and random streams that live on between calls should be explicit objects"
    )
    require(same_bits(first, again), message, problem, first, again)


@law
def check_silence(solver: DirectionSolver, problem: DirectionProblem) -> None:
    """Nothing on stdout or stderr, from Python or from C, and no warning that Python shows by default.

    Source: ten thousand subproblems a run; output belongs to the caller.
    """
    with _listen() as noise:
        answer_of(solver, problem)
    message = (
        f"solve should print nothing; found {''.join(noise)[:300]!r}. Switch output off through the back end's own"
    )
    require(not noise, f"{message} options", problem)


def writable_copy(problem: DirectionProblem) -> DirectionProblem:
    """The same problem on arrays that can be written to, as a caller's own class might have them."""
    copy = vary(problem)
    for name in _ARRAYS:
        if getattr(problem, name) is not None:
            object.__setattr__(copy, name, getattr(problem, name).copy())
    return copy


@contextmanager
def _listen() -> Iterator[list[str]]:
    """Collects what is written to stdout and stderr inside: Python's streams, the file descriptors, warnings."""
    noise: list[str] = []
    spoken = io.StringIO()
    with (
        tempfile.TemporaryFile() as file,
        redirect_stdout(spoken),
        redirect_stderr(spoken),
        warnings.catch_warnings(record=True) as shown,
    ):
        warnings.resetwarnings()
        for hidden in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
            warnings.simplefilter("ignore", hidden)
        with _descriptors_to(file.fileno()):
            yield noise
        file.seek(0)
        noise += [text for text in (spoken.getvalue(), file.read().decode(errors="replace")) if text]
        noise += [f"{warning.category.__name__}: {warning.message}" for warning in shown]


@contextmanager
def _descriptors_to(target: int) -> Iterator[None]:
    """Descriptors 1 and 2 point to `target` inside; C's buffers are flushed on both sides."""
    _flush()
    saved = [os.dup(descriptor) for descriptor in (1, 2)]
    try:
        for descriptor in (1, 2):
            os.dup2(target, descriptor)
        yield
    finally:
        _flush()
        for descriptor, original in zip((1, 2), saved, strict=True):
            os.dup2(original, descriptor)
            os.close(original)


def _flush() -> None:
    for stream in (sys.__stdout__, sys.__stderr__):
        if stream is not None:
            with suppress(ValueError, OSError):  # closed or detached by whoever captures output
                stream.flush()
    with suppress(OSError, TypeError, AttributeError):  # Windows names its C library otherwise
        ctypes.CDLL(None).fflush(None)
