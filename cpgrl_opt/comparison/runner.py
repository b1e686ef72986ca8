"""Every solver × variant on every family: each cell in a worker process, the finished ones written at once."""

import queue
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

from ..isolation import Isolated
from ..validation import require_count
from .bench import Order, isolated_bench, measurement_of
from .cell_keys import cell_keys
from .checkpoint import CellKey, Checkpoint
from .contestants import installed, variants_of
from .families import FAMILIES
from .measurement import Measurement
from .named_families import family_named

COMMON_PACKAGES = ("python", "cpgrl-opt", "numpy", "scipy", "numba", "qpsolvers")  # all cells stand on these
_LARGE_SHARE = 5  # of a family of large problems, one problem in five

Listen = Callable[[CellKey, int, int], None]  # (a cell that is finished, how many are, how many there are)


@dataclass(frozen=True, kw_only=True)
class ComparisonSettings:
    """What is compared, and how thoroughly.

    solvers: names that are installed; families: as `family_named` takes them; problems: of each family (a fifth of it
    where they are large); repeats: timed calls of each solver on a problem; limit: CPU seconds after which an answer
    is a hang, and what failures count as.
    """

    solvers: tuple[str, ...]
    families: tuple[str, ...]
    problems: int = 20
    seed: int = 0
    repeats: int = 5
    limit: float = 5.0

    def __post_init__(self) -> None:
        """ValueError for what cannot be run."""
        for name in ("problems", "repeats"):
            require_count(name, getattr(self, name))
        if not self.limit > 0:
            raise ValueError(f"limit should be positive seconds; found {self.limit}")
        require_count("seed", self.seed, 0)
        if not self.solvers or installed(self.solvers)[1]:
            raise ValueError(f"solvers should be installed, at least one; found {', '.join(self.solvers) or 'none'}")

    def cells(self) -> dict[CellKey, int]:
        """Every solver × variant × family with its number of problems, family by family."""
        return {
            (solver, variant, family): self.problems_of(family)
            for family in self.families
            for solver in self.solvers
            for variant in variants_of(solver)
            if variant == "prepared" or not family_named(family).is_large
        }

    def problems_of(self, family: str) -> int:
        """How many problems of a family are tried."""
        return max(1, self.problems // _LARGE_SHARE) if family_named(family).is_large else self.problems

    def describe(self, jobs: int) -> dict[str, object]:
        """The settings in a reader's words."""
        large = self.problems_of(next(name for name, family in FAMILIES.items() if family.is_large))
        return {
            "problems per family": self.problems,
            "problems per family of large ones (n > 100)": large,
            "timed calls of a problem": self.repeats,
            "limit in CPU seconds, at which failures count": self.limit,
            "worker processes, one thread each": jobs,
            "raw variants": "library defaults, no scaling, no polishing; n ≤ 100",
        }

    def order(self, cell: CellKey, problem: int) -> Order:
        """What a worker is sent."""
        return Order(*cell, problem, self.seed, self.limit, self.repeats)


def run_comparison(
    settings: ComparisonSettings,
    checkpoint: Checkpoint,
    *,
    jobs: int = 1,
    listen: Listen | None = None,
) -> list[Measurement]:
    """All measurements of `settings.cells()`, in their order, which is also that of the file in the end.

    Cells that the checkpoint holds are not run again; those that are not asked for stay there too, behind the others.
    Ctrl-C, or an error, ends the workers; what was finished stays.
    """
    require_count("jobs", jobs)
    cells = settings.cells()
    keys = cell_keys(cells)
    done = checkpoint.finished(cells, keys)
    remaining = [cell for cell in cells if cell not in done]
    start = monotonic()
    try:
        for measurements in _measure(settings, remaining, jobs):
            first = measurements[0]
            cell = (first.solver, first.variant, first.family)
            checkpoint.append(measurements, keys[cell])
            done[cell] = measurements
            if listen is not None:
                listen(cell, len(done), len(cells))
    finally:
        if remaining:  # reading and reporting is not measuring
            checkpoint.add_time(monotonic() - start)
    ordered = [each for cell in cells for each in done[cell]]
    checkpoint.rewrite(ordered)
    return ordered


def open_checkpoint(
    settings: ComparisonSettings, folder: Path, versions: Mapping[str, str], *, anew: bool = False
) -> Checkpoint:
    """The folder's checkpoint; see `Checkpoint` for when it is refused.

    What only some cells were measured on may change: these are measured anew.
    """
    facts = {name: getattr(settings, name) for name in ("problems", "seed", "repeats", "limit")}
    return Checkpoint(folder, facts | {"versions": versions}, fixed=COMMON_PACKAGES, anew=anew)


def _measure(settings: ComparisonSettings, cells: Sequence[CellKey], jobs: int) -> Iterator[list[Measurement]]:
    """The cells' measurements as they are finished, by `jobs` threads with a process each."""
    benches = [isolated_bench() for _ in range(min(jobs, len(cells)))]
    free: queue.SimpleQueue[Isolated] = queue.SimpleQueue()
    for bench in benches:
        free.put(bench)

    def measure(cell: CellKey) -> list[Measurement]:
        bench = free.get()
        try:
            orders = (settings.order(cell, number) for number in range(settings.problems_of(cell[2])))
            return [measurement_of(order, bench) for order in orders]
        finally:
            free.put(bench)

    with ThreadPoolExecutor(max(1, len(benches))) as pool:
        try:
            for finished in as_completed([pool.submit(measure, cell) for cell in cells]):
                yield finished.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for bench in benches:
                bench.close()
