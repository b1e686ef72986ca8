"""Parameters in parts on four devices: the same answer, and no vector travels."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("jax")

PROGRAM = r"""
import math, re
import numpy as np, jax, jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from cpgrl_opt import ConstrainedStep
from cpgrl_opt.jax import constrained_direction

jax.config.update("jax_enable_x64", True)
mesh = Mesh(np.array(jax.devices()), ("parts",))
assert mesh.size == 4
step = ConstrainedStep(formulation="linearized", step_size=0.5, restoration_rate=0.25)
rng = np.random.default_rng(0)
CHANNELS = 3
shapes = {"rows": (64, 30), "columns": (30, 64), "long": (4 * 2**14,)}
split = {"rows": (None, "parts", None), "columns": (None, None, "parts"), "long": (None, "parts")}
whole = {name: rng.normal(size=(CHANNELS, *shape)) for name, shape in shapes.items()}
parts = {name: jax.device_put(V, NamedSharding(mesh, PartitionSpec(*split[name]))) for name, V in whole.items()}
values, limits = np.array([0.0, 0.3, -0.2]), np.zeros(2)

move = jax.jit(lambda values, V, limits: constrained_direction(values, V, limits, step))
compiled = move.lower(values, parts, limits).compile()
travels = [
    math.prod(map(int, filter(None, shape.split(","))))
    for line in compiled.as_text().splitlines()
    if re.search(r" (all-gather|all-reduce|all-to-all|collective-permute|reduce-scatter)(-start)?[(]", line)
    for shape in re.findall(r"[a-z]+[0-9]+\[([0-9,]*)\]", line.split("(%")[0])
]
assert travels and max(travels) <= 4 * (1 + CHANNELS) ** 2, travels
gradient, info = move(values, parts, limits)
expected, same = move(values, whole, limits)
assert info.status == same.status == 0
assert (info.multipliers > 0).any()
np.testing.assert_allclose(info.multipliers, same.multipliers, rtol=1e-12, atol=1e-12)
for name, part in gradient.items():
    wanted = NamedSharding(mesh, PartitionSpec(*split[name][1:]))
    assert part.sharding.is_equivalent_to(wanted, part.ndim), part.sharding
    np.testing.assert_allclose(part, expected[name], rtol=1e-12, atol=1e-12)
"""


def test_of_parts_on_four_devices_no_vector_travels(tmp_path: Path) -> None:
    """What the compiled program sends is at most one number a pair of channels and device."""
    flags = {
        "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=4",
        "JAX_PLATFORMS": "cpu",
    }
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, filter(None, sys.path))), **flags}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
