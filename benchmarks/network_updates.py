"""How much time and memory does an update under constraints take, beside one backward pass and beside TorchJD?

A network of two layers and n parameters, 1 + m outputs on 16 samples: the loss is the mean of the first, each cost that
of another; every other cost is violated. float32. An update goes from a forward pass to what the optimiser takes: the
forward pass is in all times. Where Adam is named, its step is in it too.

- memory: most that one update adds to what a process holds, in gradients of n numbers; the parameters, and Adam's
  two moments, are there before. glibc is told to give back what is freed;
- time: CPU time, medians, in turns.

    OMP_NUM_THREADS=1 python benchmarks/network_updates.py [--parameters 100000,1000000,10000000]
        [--constraints 1,5,31] [--repetitions 3] [--out benchmarks/results]

Limitations: one machine, one thread, no accelerator, one kind of network, whose graph is small. TorchJD solves another
problem (no thresholds, the mean of all rows), once as it comes and once with its settings that spare memory; these
spare nothing here, where most parameters are in one tensor.
"""

import importlib.util
import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from long_memory import forget_peak, peak
from tables import machine, publish, read_arguments, table
from turns import time_in_turns

from cpgrl_opt import ConstrainedStep
from cpgrl_opt.torch import ConstrainedOptimizer, constrained_backward

SAMPLES, INPUTS = 16, 100
STEP = ConstrainedStep(formulation="restoring", step_size=0.01)


@dataclass(frozen=True)
class Row:
    """One contender at one size."""

    contender: str
    n: int
    m: int
    milliseconds: float
    over_backward: float
    megabytes: float
    gradients: float  # memory over that of n numbers


class Loop:
    """A network, its data, and the update of one contender."""

    def __init__(self, contender: str, n: int, m: int) -> None:
        torch.manual_seed(0)
        width = max(1, round(n / (INPUTS + 2 + m)))
        self.net = torch.nn.Sequential(
            torch.nn.Linear(INPUTS, width), torch.nn.Tanh(), torch.nn.Linear(width, 1 + m)
        )  # fmt: skip
        self.parameters = [*self.net.parameters()]
        self.inputs = torch.randn(SAMPLES, INPUTS)
        with torch.no_grad():
            costs = self.outputs()[1:]
        self.thresholds = costs + 0.1 - 0.2 * (torch.arange(m) % 2 == 0)
        self.update, self.optimizer = CONTENDERS[contender], None
        if "Adam" in contender:
            self.optimizer = torch.optim.Adam(self.parameters, lr=1e-9)  # the outputs stay what they are
            if "Constrained" in contender:
                self.optimizer = ConstrainedOptimizer(self.optimizer, STEP)

    def outputs(self) -> Any:
        """Loss and costs, (1 + m,)."""
        return self.net(self.inputs).mean(dim=0)

    def __call__(self) -> None:
        """One update."""
        self.net.zero_grad()
        outputs = self.outputs()
        self.update(self, outputs[0], outputs[1:])


def backward(loop: Loop, loss: Any, costs: Any) -> None:  # noqa: ARG001
    """The objective alone, with or without Adam."""
    loss.backward()
    if loop.optimizer is not None:
        loop.optimizer.step()


def ours(loop: Loop, loss: Any, costs: Any) -> None:
    """`constrained_backward`."""
    constrained_backward(loss, costs, thresholds=loop.thresholds, parameters=loop.parameters, step=STEP)


def constrained_adam(loop: Loop, loss: Any, costs: Any) -> None:
    """`ConstrainedOptimizer(Adam)`."""
    assert loop.optimizer is not None
    loop.optimizer.constrain(costs, thresholds=loop.thresholds)
    loss.backward()
    loop.optimizer.step()


def torchjd(spare: bool, loop: Loop, loss: Any, costs: Any) -> None:
    """DualProj; spare: its settings that take less memory."""
    from torchjd.aggregation import DualProj
    from torchjd.autojac import backward, jac_to_grad

    backward([loss, costs], inputs=loop.parameters, parallel_chunk_size=1 if spare else None)
    jac_to_grad(loop.parameters, DualProj(), optimize_gramian_computation=spare)


CONTENDERS: dict[str, Callable[[Loop, Any, Any], None]] = {
    "loss.backward()": backward,
    "ours: constrained_backward": ours,
    "TorchJD: DualProj": partial(torchjd, False),
    "TorchJD: DualProj, sparing": partial(torchjd, True),
    "loss.backward(), Adam": backward,
    "ours: ConstrainedOptimizer(Adam)": constrained_adam,
}


def measure_memory(contender: str, n: int, m: int) -> float:
    """Bytes that one update adds to what this process holds, in which nothing else runs."""
    torch.set_num_threads(1)
    Loop(contender, 10_000, m)()
    loop = Loop(contender, n, m)
    if loop.optimizer is not None:  # its moments are there before
        loop()
    loop.net.zero_grad()
    forget_peak()
    before = peak()
    loop()
    return peak() - before


def measure(
    n: int, m: int, repetitions: int, contenders: list[str], other_process: ProcessPoolExecutor
) -> Iterator[Row]:
    """All contenders: times here, in turns, and memory in the other process, one after the other."""
    seconds: dict[str, Any] = {}
    for names in ([each for each in contenders if "Adam" not in each], [each for each in contenders if "Adam" in each]):
        found, _ = time_in_turns({name: Loop(name, n, m) for name in names}, repetitions)
        seconds |= {name: float(np.median(times)) for name, times in found.items()}
    added = [*other_process.map(partial(measure_memory, n=n, m=m), contenders)]
    for name, extra in zip(contenders, added, strict=True):
        plain = seconds["loss.backward(), Adam" if "Adam" in name else "loss.backward()"]
        yield Row(name, n, m, 1e3 * seconds[name], seconds[name] / plain, 1e-6 * extra, extra / (4 * n))


def main() -> None:
    """Measures, prints and writes."""
    sizes = [100_000, 1_000_000, 10_000_000]
    arguments = read_arguments(__doc__, parameters=sizes, constraints=[1, 5, 31], repetitions=3)
    torch.set_num_threads(1)
    # For the other process: what is freed goes back at once, so that the next peak shows it.
    os.environ.update(MALLOC_MMAP_THRESHOLD_="65536", MALLOC_TRIM_THRESHOLD_="65536")
    has_torchjd = importlib.util.find_spec("torchjd") is not None
    if not has_torchjd:
        print("SKIP TorchJD: not installed, its lines are missing")
    contenders = [name for name in CONTENDERS if has_torchjd or "TorchJD" not in name]
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as other_process:
        rows = [
            row
            for n in arguments.parameters
            for m in arguments.constraints
            for row in measure(n, m, arguments.repetitions, contenders, other_process)
        ]
    heads = "| contender | n | m | ms | × backward | MB | gradients of memory |"
    line = (
        "| {0.contender} | {0.n:.0e} | {0.m:d} | {0.milliseconds:.3g} | {0.over_backward:.1f} | "
        "{0.megabytes:.1f} | {0.gradients:.1f} |"
    )
    about = (
        "An update from the forward pass to `.grad`, or past Adam's step where that is named. × backward: time over "
        "that of the objective alone, with Adam where that is named."
    )
    used = ["torch", *(["torchjd"] if has_torchjd else [])]
    publish(arguments, "Time and memory of an update", [about, table(heads, line, rows), f"{machine(*used)}."], rows)


if __name__ == "__main__":
    main()
