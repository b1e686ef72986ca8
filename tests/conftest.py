"""Shared by all tests: the slow marker, Hypothesis profiles, and shape checks of what is annotated."""

import importlib.util
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

# Shapes are checked in the tests only. Compiled kernels stay out of the hook: a decorated kernel is no kernel.
install_import_hook(
    [
        "cpgrl_opt.active_set",
        "cpgrl_opt.direction",
        "cpgrl_opt.formulation",
        "cpgrl_opt.kkt",
        "cpgrl_opt.linearization",
        "cpgrl_opt.metric",
        "cpgrl_opt.problem",
        "cpgrl_opt.projection",
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
        path = Path(__file__).parents[1] / "benchmarks" / f"{name}.py"
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module  # where dataclasses look for their annotations
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
