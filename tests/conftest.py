"""Shared by all tests: the slow marker, Hypothesis profiles, shape checks of what is annotated, and whose turn it is
to compile.
"""

import functools
import importlib.util
import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import jaxtyping
import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).parents[1]

# Calls of each function whose shapes are checked in each test: the first, and then one out of so many. A law that is
# put to thousands of problems would ask for the same shapes again and again, for a third of its time.
FIRST_CALLS = 20
ONE_OUT_OF = 16
_calls: Counter[FunctionType] = Counter()


def check_at_times(every_time: Callable[..., Any]) -> Callable[..., Any]:
    """jaxtyping's decorator, by which the import hook below checks every call, for some of the calls of a function."""

    def decorator(*, typechecker: Any) -> Callable[[Any], Any]:
        def decorate(found: Any) -> Any:
            checked = every_time(found, typechecker=typechecker)
            if not isinstance(found, FunctionType):
                return checked

            @functools.wraps(checked)
            def called(*args: Any, **kwargs: Any) -> Any:
                __tracebackhide__ = True
                _calls[found] += 1
                number = _calls[found]
                is_checked = number <= FIRST_CALLS or number % ONE_OUT_OF == 0
                return (checked if is_checked else found)(*args, **kwargs)

            return called

        return decorate

    return decorator


# Shapes are checked in the tests only. Compiled kernels stay out of the hook: a decorated kernel is no kernel.
jaxtyping.jaxtyped = check_at_times(jaxtyping.jaxtyped)
jaxtyping.install_import_hook(
    [
        "cpgrl_opt.active_set",
        "cpgrl_opt.direction",
        "cpgrl_opt.formulation",
        "cpgrl_opt._evidence",
        "cpgrl_opt._violation",
        "cpgrl_opt.certify",
        "cpgrl_opt.linearization",
        "cpgrl_opt.metric",
        "cpgrl_opt.problem",
        "cpgrl_opt.scaling",
        "cpgrl_opt.projection",
        "cpgrl_opt._step_run",
        "cpgrl_opt.step",
        "envs.markov_chain",
        "envs.occupancy",
    ],
    "beartype.beartype",
)

_quiet = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow, HealthCheck.data_too_large]}
settings.register_profile("default", max_examples=100, **_quiet)
settings.register_profile("ci", max_examples=100, derandomize=True, database=None, **_quiet)
settings.register_profile("nightly", max_examples=10_000, **_quiet)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci" if os.environ.get("CI") else "default"))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--run-slow", action="store_true", help="run the tests that take over ten seconds too")


def pytest_runtest_setup(item: pytest.Item) -> None:
    _calls.clear()
    skip_broken(getattr(getattr(item, "callspec", None), "params", {}).values())


def skip_broken(parameters: Iterable[object]) -> None:
    """Skips, with the reason, a test of a solver whose package is there but cannot be imported on this machine."""
    from cpgrl_opt.solvers import SOLVERS, is_installed, obstacle
    from cpgrl_opt.solvers.base import Solver

    for parameter in parameters:
        solver = SOLVERS.get(parameter) if isinstance(parameter, str) else parameter
        if isinstance(solver, Solver) and is_installed(solver) and (why := obstacle(solver)):
            pytest.skip(f"{getattr(solver, 'name', solver)} is {why}")


def compile_projections() -> None:
    """The kernels of `cpgrl_opt`."""
    _ = import_module("cpgrl_opt.direct_step").move_parameters.machine_code
    import_module("cpgrl_opt.solvers").compile_kernels()


def compile_rollouts() -> None:
    """The kernels of `rl` and `envs`."""
    for name in ("estimators.finite_learning", "drivers.finite", "drivers.continuous"):
        import_module(f"rl.{name}")
    for name in ("gpomdp", "konda_actor_critic"):
        _ = import_module(f"rl.estimators.{name}").advance.machine_code
    import_module("envs.arm_kernels")


@contextmanager
def hold_lock(path: Path) -> Iterator[None]:
    """Waits while another process is in such a block; on Windows it does not."""
    with path.open("rb") as file:
        with suppress(ImportError):
            import_module("fcntl").flock(file, 2)  # LOCK_EX; ends with the file, however the process ends
        yield


def pytest_sessionstart(session: pytest.Session) -> None:
    """Where nothing is cached, two workers of pytest-xdist compile half of the kernels each, not each of them all."""
    halves = [(compile_projections, ROOT / "cpgrl_opt"), (compile_rollouts, ROOT / "rl")]
    worker = os.environ.get("PYTEST_XDIST_WORKER")
    if worker is None:
        return
    for compile_half, package in halves if int(worker.removeprefix("gw")) % 2 == 0 else reversed(halves):
        with hold_lock(package / "__init__.py"):
            compile_half()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--run-slow"):
        return
    for item in items:
        if "slow" in item.keywords:
            item.add_marker(pytest.mark.skip(reason="slow: run with --run-slow"))


@pytest.fixture(scope="session")
def load_benchmark() -> Callable[[str], ModuleType]:
    """load_benchmark("arm_speed"): benchmarks/arm_speed.py as a module; the folder is no package."""

    def load(name: str) -> ModuleType:
        path = ROOT / "benchmarks" / f"{name}.py"
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module  # where dataclasses look for their annotations
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(path.parent)  # a script's own folder comes first
            spec.loader.exec_module(module)
        return module

    return load


@pytest.fixture
def hears_interrupts() -> Iterator[None]:
    """Ctrl-C works as at a terminal: in the background of a script it is ignored, by what is started there too."""
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, previous)


@pytest.fixture
def start_cpgrl(hears_interrupts: None) -> Iterator[Callable[..., "subprocess.Popen[str]"]]:
    """start_cpgrl(*arguments): the command as its own process group, of which nothing outlives the test."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: object) -> "subprocess.Popen[str]":
        command = [sys.executable, "-m", "rl.cli", *map(str, arguments)]
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        started.append(subprocess.Popen(command, **streams, text=True, start_new_session=True))
        return started[-1]

    yield start
    for process in started:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
