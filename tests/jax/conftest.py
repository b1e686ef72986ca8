"""float64 for all tests of this folder, as whoever asks for it has it; nothing outside the folder sees it."""

import os
from collections.abc import Iterator

import pytest

# Most of the time goes to compiling, which takes half as long so; read as JAX starts.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")


@pytest.fixture(autouse=True)
def float64() -> Iterator[None]:
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)
