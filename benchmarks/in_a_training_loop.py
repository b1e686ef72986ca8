"""The same agent in one training loop under each library: return, violation, time and lines of glue.

    max E[progress to the goal]   s.t.   share of time in a disc in the way ≤ 0.1,   E|a|² ≤ 0.4

A point in the plane starts left of the disc, the goal lies right of it. Actions are drawn around what a network of two
hidden layers says, with a spread that is learned, and cut at ±2; at the start |a|² is too large. REINFORCE, reward to
go, a baseline for each step of an episode. What comes after the losses is in `loop_contenders`: all get the same
tensors.

Six settings are tried for each contender, on seeds that are not used again; the best by return − 10 · worst violation
(of Adam without constraints by its return) is trained from each of the seeds that count. The policies are judged by
new episodes, violations in units of the threshold. Times are CPU times from the losses to the changed parameters.

    OMP_NUM_THREADS=1 python benchmarks/in_a_training_loop.py [--seeds 10] [--tuning-seeds 2] [--updates 80]
        [--out benchmarks/results]

Limitations: one small task, made up for this page, and a short training. Six settings on two seeds are few; task and
grids were chosen by us, after a trial on one of the tuning seeds, and some choices lie at the edge of a grid. TorchJD
is meant for several losses and has no thresholds: it gets a cost's violation as a loss. Cooper is meant for long
training, in which multipliers settle. Lines are counted in code of ours. The last policy is judged, not the best on the
way.
"""

import importlib.util
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.stats
import torch
from loop_contenders import CONTENDERS, Update, count_lines
from tables import machine, publish, read_arguments, table

STEPS, EPISODES, JUDGED = 20, 128, 500
LIMITS = torch.tensor([0.1, 0.4])
# Return that a violation of all of a threshold costs, where settings are chosen: more than any has to gain.
PENALTY = 10.0
EVERY = 10  # updates between two looks at the policy
NOTICED = 0.05  # of a threshold: the error of 500 episodes is about as much


@dataclass(frozen=True)
class Row:
    """One run of one contender with the setting that was chosen for it."""

    contender: str
    setting: str
    seed: int
    returned: float
    violation: float  # of the last policy, its worst constraint
    mean_violation: float  # over all looks
    updates_to_feasible: int  # after which a look finds both met; one more than all where none does
    milliseconds: float
    lines: int


class Policy(torch.nn.Module):  # type: ignore[misc]
    """a ~ N(network(position), spread²)."""

    def __init__(self) -> None:
        super().__init__()
        width = 64
        self.mean = torch.nn.Sequential(
            torch.nn.Linear(2, width), torch.nn.Tanh(), torch.nn.Linear(width, width), torch.nn.Tanh(),
            torch.nn.Linear(width, 2),
        )  # fmt: skip
        self.log_spread = torch.nn.Parameter(torch.full((2,), -0.7))

    def forward(self, position: Any) -> tuple[Any, Any]:
        """Mean and spread."""
        return self.mean(position), self.log_spread.clamp(-3.0, 1.0).exp()


@torch.no_grad()  # type: ignore[untyped-decorator,unused-ignore]
def roll_out(policy: Policy, episodes: int) -> tuple[Any, Any, Any]:
    """Positions and actions, (STEPS, episodes, 2), and (STEPS, episodes, 3): progress, being in the disc, |a|²."""
    goal = torch.tensor([1.0, 0.0])
    position = torch.tensor([-1.0, 0.0]) + 0.1 * torch.randn(episodes, 2)
    positions, actions, channels = [], [], []
    for _ in range(STEPS):
        mean, spread = policy(position)
        action = mean + spread * torch.randn(episodes, 2)
        motion = action.clamp(-2.0, 2.0)
        moved = position + 0.2 * motion
        progress = (position - goal).norm(dim=1) - (moved - goal).norm(dim=1)
        inside = (moved.norm(dim=1) < 0.5).float()
        positions.append(position)
        actions.append(action)
        channels.append(torch.stack([progress, inside / STEPS, motion.square().sum(dim=1) / STEPS], dim=1))
        position = moved
    return torch.stack(positions), torch.stack(actions), torch.stack(channels)


def estimate(policy: Policy) -> tuple[Any, Any]:
    """Loss and costs (2,): tensors with the batch's means as values and its policy gradients as gradients."""
    positions, actions, channels = roll_out(policy, EPISODES)
    to_go = channels.flip(0).cumsum(0).flip(0)
    advantage = to_go - to_go.mean(dim=1, keepdim=True)
    mean, spread = policy(positions)
    score = -(0.5 * ((actions - mean) / spread).square() + spread.log()).sum(dim=2, keepdim=True)
    surrogate = (score * advantage).sum(dim=0).mean(dim=0)
    values = channels.sum(dim=0).mean(dim=0) + surrogate - surrogate.detach()
    return -values[0], values[1:]


def look(policy: Policy) -> tuple[float, float]:
    """Return and worst violation, over the threshold, of new episodes."""
    means = roll_out(policy, JUDGED)[2].sum(dim=0).mean(dim=0)
    return float(means[0]), float(((means[1:] - LIMITS) / LIMITS).max().clamp(min=0.0))


def train(name: str, setting: tuple[Any, ...], seed: int, updates: int) -> Row:
    """From a new policy; the looks have random numbers of their own, the same for all."""
    glue = CONTENDERS[name][0]
    torch.manual_seed(seed)
    policy = Policy()
    update: Update = glue([*policy.parameters()], *setting)
    seconds, looks = [], []
    for number in range(1, updates + 1):
        loss, costs = estimate(policy)
        begun = time.thread_time()
        update(loss, costs, LIMITS)
        seconds.append(time.thread_time() - begun)
        if number % EVERY == 0 or number == updates:
            with torch.random.fork_rng():
                torch.manual_seed(1_000_000 * seed + number)
                looks.append((number, *look(policy)))
    reached = [number for number, _, violation in looks if violation <= NOTICED]
    return Row(
        contender=name,
        setting=", ".join(f"{each:g}" if isinstance(each, float) else each for each in setting),
        seed=seed,
        returned=looks[-1][1],
        violation=looks[-1][2],
        mean_violation=float(np.mean([violation for *_, violation in looks])),
        updates_to_feasible=reached[0] if reached else updates + 1,
        milliseconds=1e3 * float(np.median(seconds)),
        lines=count_lines(glue),
    )


def tune(name: str, seeds: Sequence[int], updates: int) -> tuple[Any, ...]:
    """The setting whose mean return − PENALTY · violation is best."""
    weight = 0.0 if name.startswith("Adam") else PENALTY
    scores = {}
    for setting in CONTENDERS[name][1]:
        runs = [train(name, setting, seed, updates) for seed in seeds]
        scores[setting] = np.mean([run.returned - weight * run.violation for run in runs])
    return max(scores, key=lambda setting: scores[setting])


def available() -> list[str]:
    """Contenders whose package is installed; the others are said to be missing."""
    found = [name for name, (_, _, package) in CONTENDERS.items() if importlib.util.find_spec(package)]
    for name in CONTENDERS:
        if name not in found:
            print(f"SKIP {name}: not installed, its line is missing")
    return found


def interval(values: Sequence[float], digits: int) -> str:
    """Mean ± half of Student's 95 % interval."""
    numbers = np.array(values, dtype=np.float64)
    half = 0.0
    if len(numbers) > 1:
        half = scipy.stats.t.ppf(0.975, len(numbers) - 1) * numbers.std(ddof=1) / len(numbers) ** 0.5
    return f"{numbers.mean():.{digits}f} ± {half:.{digits}f}"


def summarise(rows: Sequence[Row], updates: int) -> str:
    """A line for each contender."""
    lines = []
    for name in dict.fromkeys(row.contender for row in rows):
        runs = [row for row in rows if row.contender == name]
        reached = [run.updates_to_feasible for run in runs if run.updates_to_feasible <= updates]
        lines.append((
            name,
            runs[0].setting,
            interval([run.returned for run in runs], 3),
            interval([100 * run.violation for run in runs], 1),
            interval([100 * run.mean_violation for run in runs], 0),
            f"{np.median(reached):.0f}" if reached else "–",
            f"{len(reached)} of {len(runs)}",
            np.median([run.milliseconds for run in runs]),
            runs[0].lines,
        ))  # fmt: skip
    heads = (
        "| contender | chosen | return | violation, % | on the way, % | updates to feasible | reached by | ms | lines |"
    )
    line = "| {0[0]} | {0[1]} | {0[2]} | {0[3]} | {0[4]} | {0[5]} | {0[6]} | {0[7]:.2f} | {0[8]:d} |"
    return table(heads, line, lines)


def main() -> None:
    """Tunes, trains, prints and writes."""
    arguments = read_arguments(__doc__, seeds=10, tuning_seeds=2, updates=80)
    torch.set_num_threads(1)
    names = available()
    tuning = range(1000, 1000 + arguments.tuning_seeds)
    chosen = {name: tune(name, tuning, arguments.updates) for name in names}
    runs = [
        train(name, chosen[name], seed, arguments.updates)  # in turns, for the times
        for seed in range(arguments.seeds)
        for name in names
    ]
    rows = sorted(runs, key=lambda row: names.index(row.contender))
    about = f"""Means over {arguments.seeds} runs and Student's 95 % intervals; {arguments.updates} updates.

- violation: of the last policy's worst constraint, in % of its threshold; on the way: mean over looks every {EVERY} \
updates
- updates to feasible: median of the runs that reached it; to the first look with no violation > {100 * NOTICED:.0f} %
- ms: CPU time from the losses to the changed parameters, median; lines: of glue, in `benchmarks/loop_contenders.py`"""
    used = [package for package in ("torchjd", "cooper-optim") if any(package[:6] in name.lower() for name in names)]
    title = "The same agent in a training loop, library by library"
    publish(arguments, title, [about, summarise(rows, arguments.updates), f"{machine('torch', *used)}."], rows)


if __name__ == "__main__":
    main()
