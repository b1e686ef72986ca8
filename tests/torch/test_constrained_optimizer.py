"""`ConstrainedOptimizer`: after any optimiser's step slack + J·Δθ is what the formulation demands, to first order."""

import weakref
from copy import deepcopy
from functools import partial
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from torch.utils._python_dispatch import TorchDispatchMode  # noqa: E402

from cpgrl_opt import (  # noqa: E402
    ConstrainedStep,
    Direction,
    DirectionError,
    DirectionProblem,
    Status,
    hysteresis,
    solve,
)
from cpgrl_opt.torch import ConstrainedOptimizer  # noqa: E402

OPTIMIZERS: dict[str, Any] = {
    "SGD": lambda p: torch.optim.SGD(p, lr=0.1),
    "momentum": lambda p: torch.optim.SGD(p, lr=0.1, momentum=0.9, nesterov=True, weight_decay=0.1),
    "Adam": lambda p: torch.optim.Adam(p, lr=0.05),
    "foreach": lambda p: torch.optim.Adam(p, lr=0.05, foreach=True, amsgrad=True),
    "fused": lambda p: torch.optim.AdamW(p, lr=0.05, weight_decay=0.5, fused=True),
    "NAdam": lambda p: torch.optim.NAdam(p, lr=0.05),
    "RAdam": lambda p: torch.optim.RAdam(p, lr=0.05),
    "Adamax": lambda p: torch.optim.Adamax(p, lr=0.05),
    "RMSprop": lambda p: torch.optim.RMSprop(p, lr=0.05, momentum=0.5, centered=True),
    "Adagrad": lambda p: torch.optim.Adagrad(p, lr=0.05, lr_decay=0.1),
    "Adadelta": lambda p: torch.optim.Adadelta(p, lr=1.0),
    "LBFGS": lambda p: torch.optim.LBFGS(p, lr=0.5, max_iter=3),
}
FORMULATIONS = {
    "cone": ConstrainedStep(formulation="cone", restoration_rate=0.5),
    "restoring": ConstrainedStep(formulation="restoring", restoration_rate=0.5),
    "linearized": ConstrainedStep(formulation="linearized", restoration_rate=0.5, slack_fraction=0.8),
    "equality": ConstrainedStep(formulation="equality", restoration_rate=0.5, drop="never"),
}
FLOATS = {torch.float64: 1e-9, torch.float32: 1e-4}


class Task:
    """Quadratic losses: two groups of parameters, and costs c·θ + ½‖θ‖²/8 whose gradients are known."""

    def __init__(self, seed: int, dtype: Any) -> None:
        rng = np.random.default_rng(seed)
        self.parameters = [torch.nn.Parameter(torch.tensor(rng.normal(size=k), dtype=dtype)) for k in ((3, 2), (4,))]
        self.goal, self.rows = rng.normal(size=10), rng.normal(size=(3, 10))
        self.thresholds = self.costs().detach().double().numpy() + np.array([-0.05, 0.02, 0.5])

    def flat(self) -> Any:
        return torch.cat([each.reshape(-1) for each in self.parameters])

    def numbers(self) -> np.ndarray:
        return self.flat().detach().double().numpy()

    def loss(self) -> Any:
        return (self.flat() - torch.tensor(self.goal).to(self.flat())).square().sum()

    def costs(self) -> Any:
        flat = self.flat()
        return torch.tensor(self.rows).to(flat) @ flat + flat.square().sum() / 8.0

    def jacobian(self) -> np.ndarray:
        return -(self.rows + self.numbers() / 4.0)


def demand(step: ConstrainedStep, slack: np.ndarray) -> np.ndarray:
    """What J·Δθ has to be at least."""
    asked = float(step.restoration_rate) * np.maximum(-slack, 0.0)
    if step.formulation == "linearized":
        return asked - float(step.slack_fraction) * np.maximum(slack, 0.0)
    return np.where(slack <= 0.0, asked, -np.inf)


def move_once(task: Task, optimizer: Any, *, by_closure: bool = False) -> None:
    def closure() -> Any:
        optimizer.zero_grad()
        if isinstance(optimizer, ConstrainedOptimizer):
            optimizer.constrain(task.costs(), thresholds=task.thresholds)
        loss = task.loss()
        loss.backward()
        return loss

    if by_closure:
        assert optimizer.step(closure) is not None
    else:
        closure()
        optimizer.step()


@pytest.mark.parametrize("dtype", FLOATS)
@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("name", OPTIMIZERS)
def test_no_constraint_is_left_worse_than_asked(name: str, formulation: str, dtype: Any) -> None:
    step, tolerance = FORMULATIONS[formulation], FLOATS[dtype]
    for seed in range(2):
        task = Task(seed, dtype)
        optimizer = ConstrainedOptimizer(OPTIMIZERS[name](task.parameters), step)
        for _ in range(3):
            before, J = task.numbers(), task.jacobian()
            slack = task.thresholds - task.costs().detach().double().numpy()

            move_once(task, optimizer, by_closure=name in ("LBFGS", "Adamax"))
            info, move = optimizer.info, J @ (task.numbers() - before)
            assert info.status == Status.OPTIMAL
            assert (move - demand(step, slack) >= -tolerance * (1.0 + np.abs(move))).all()
            np.testing.assert_allclose(info.predicted_slack, slack + move, atol=tolerance * (1.0 + np.abs(move).max()))
            if formulation == "equality":
                active = slack <= 0.0
                np.testing.assert_allclose(move[active], demand(step, slack)[active], atol=tolerance)


def adam_metric(parameter: Any, optimizer: Any, lr: float) -> np.ndarray:
    state = optimizer.state[parameter]
    v = state["exp_avg_sq"].numpy() / (1.0 - 0.999 ** state["step"].item())
    return (np.sqrt(v) + 1e-8).ravel() / lr


def test_what_adam_proposes_is_projected_in_adams_metric() -> None:
    """Against the proposal of a plain Adam, and a problem with the metric as an array."""
    ours, plain = Task(3, torch.float64), Task(3, torch.float64)
    step = ConstrainedStep(formulation="restoring", restoration_rate=1.0)
    groups = [
        [{"params": [first], "lr": 0.2}, {"params": [second]}] for first, second in (ours.parameters, plain.parameters)
    ]
    optimizer = ConstrainedOptimizer(torch.optim.Adam(groups[0], lr=0.05), step)
    other = torch.optim.Adam(groups[1], lr=0.05)
    for each in (optimizer, other):
        move_once(ours if each is optimizer else plain, each)
    start = Task(3, torch.float64)
    rates = [0.2, 0.05]
    H = np.concatenate([adam_metric(p, other, lr) for p, lr in zip(plain.parameters, rates, strict=True)])
    slack = start.thresholds - start.costs().detach().numpy()
    proposal = plain.numbers() - start.numbers()
    bound = np.where(slack <= 0.0, np.maximum(-slack, 0.0), -np.inf)
    expected = solve(DirectionProblem(H * proposal, start.jacobian(), bound, metric=H))
    assert expected.multipliers.any()
    np.testing.assert_allclose(ours.numbers() - start.numbers(), expected.value, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(optimizer.info.multipliers, expected.multipliers, rtol=1e-7)


def test_where_nothing_binds_it_is_the_optimiser_bit_for_bit() -> None:
    ours, plain = Task(0, torch.float32), Task(0, torch.float32)
    optimizer = ConstrainedOptimizer(torch.optim.Adam(ours.parameters), ConstrainedStep())
    other = torch.optim.Adam(plain.parameters)
    ours.thresholds = ours.thresholds + 9.0
    for _ in range(3):
        move_once(ours, optimizer)
        move_once(plain, other)
    np.testing.assert_array_equal(ours.numbers(), plain.numbers())


def test_a_saved_run_goes_on_as_if_it_had_not_been_saved_and_a_scheduler_is_heard() -> None:
    step = ConstrainedStep(formulation="restoring", rule=partial(hysteresis, leave=0.1))
    task, later = Task(1, torch.float64), Task(1, torch.float64)
    optimizer = ConstrainedOptimizer(torch.optim.Adam(task.parameters, lr=0.05), step)
    scheduler = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.5)
    for _ in range(2):
        move_once(task, optimizer)
        scheduler.step()
    assert optimizer.param_groups[0]["lr"] == 0.0125
    again = ConstrainedOptimizer(torch.optim.Adam(later.parameters, lr=9.0), step)
    for mine, its in zip(later.parameters, task.parameters, strict=True):
        mine.data.copy_(its)
    again.load_state_dict(deepcopy(optimizer.state_dict()))
    for _ in range(2):
        move_once(task, optimizer)
        move_once(later, again)
    np.testing.assert_array_equal(task.numbers(), later.numbers())
    plain = optimizer.optimizer.state_dict()
    again.load_state_dict(plain)  # of an optimiser that was not wrapped


def test_metrics_of_the_callers_frozen_groups_and_parameters_without_state() -> None:
    task = Task(0, torch.float64)
    first, second = task.parameters
    groups = [{"params": [first]}, {"params": [second], "lr": 0.0}]
    optimizer = ConstrainedOptimizer(
        torch.optim.SGD(groups, lr=0.1), FORMULATIONS["restoring"], metric=lambda p: torch.ones_like(p) + (p > 0.0)
    )
    kept, before = second.detach().clone(), task.numbers()
    slack, J = task.thresholds - task.costs().detach().numpy(), task.jacobian()
    move_once(task, optimizer)
    assert torch.equal(second, kept)
    assert ((J @ (task.numbers() - before) - demand(FORMULATIONS["restoring"], slack))[slack <= 0.0] >= -1e-9).all()
    optimizer.zero_grad()
    optimizer.constrain([first.sum()], thresholds=[first.sum().item() - 0.1], retain_graph=False)
    second.square().sum().backward()  # of the first no gradient comes from the objective
    optimizer.param_groups[1]["lr"] = 0.1
    optimizer.step()
    assert optimizer.info.predicted_slack[0] == pytest.approx(-0.05)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_at_rate_zero_nothing_moves_and_only_what_should_be_restored_is_infeasible(formulation: str) -> None:
    task = Task(0, torch.float64)
    optimizer = ConstrainedOptimizer(torch.optim.Adam(task.parameters, lr=0.0), FORMULATIONS[formulation])
    before = task.numbers()
    move_once(task, optimizer)  # the first constraint is violated
    assert optimizer.info.status == Status.INFEASIBLE
    np.testing.assert_array_equal(optimizer.info.multipliers, [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(optimizer.info.predicted_slack, optimizer.info.slack)
    task.thresholds[0] += 0.05
    move_once(task, optimizer)  # now it is met, by 0
    assert optimizer.info.status == Status.OPTIMAL
    assert not optimizer.info.multipliers.any()
    np.testing.assert_array_equal(task.numbers(), before)


def test_hooks_after_a_step_see_what_was_taken_and_failed_steps_have_none() -> None:
    task, seen = Task(0, torch.float64), []
    inner = torch.optim.SGD(task.parameters, lr=0.1)
    inner.register_step_post_hook(lambda *_: seen.append(task.numbers()))
    optimizer = ConstrainedOptimizer(inner, FORMULATIONS["cone"])
    move_once(task, optimizer)
    np.testing.assert_array_equal(seen, [task.numbers()])
    optimizer.metric = lambda p: -torch.ones_like(p)
    with pytest.raises(ValueError, match="metric"):
        move_once(task, optimizer)
    optimizer.metric = None
    move_once(task, optimizer)
    assert len(seen) == 2


@pytest.mark.parametrize("failed", ["step", "constrain"])
def test_what_was_asked_before_a_failure_is_forgotten(failed: str) -> None:
    task = Task(0, torch.float64)
    optimizer = ConstrainedOptimizer(torch.optim.SGD(task.parameters, lr=0.1), FORMULATIONS["cone"])
    optimizer.constrain(task.costs(), thresholds=task.thresholds)
    (task.loss() * np.nan).backward()
    fail = partial(optimizer.constrain, task.costs() * np.nan, values=[0.0] * 3, thresholds=task.thresholds)
    with pytest.raises(ValueError, match="finite"):
        (optimizer.step if failed == "step" else fail)()
    optimizer.zero_grad()
    task.loss().backward()
    with pytest.raises(ValueError, match="constrain should be called"):
        optimizer.step()


def test_sparse_gradients_of_the_objective_are_refused() -> None:
    table = torch.nn.Embedding(3, 2, sparse=True)
    optimizer = ConstrainedOptimizer(torch.optim.SGD(table.parameters(), lr=0.1), FORMULATIONS["cone"])
    optimizer.constrain([table.weight.sum()], thresholds=[0.0])
    table(torch.tensor([1])).sum().backward()
    with pytest.raises(ValueError, match="objective should have dense gradients"):
        optimizer.step()


def test_an_infeasible_step_is_an_answer_also_where_failures_raise() -> None:
    p = torch.nn.Parameter(torch.zeros(2, dtype=torch.float64))
    step = ConstrainedStep(formulation="linearized", on_failure="raise")
    optimizer = ConstrainedOptimizer(torch.optim.SGD([p], lr=0.1), step)
    optimizer.constrain([p[0], -p[0]], values=[1.0, 1.0], thresholds=[0.0, 0.0])
    p.sum().backward()
    optimizer.step()
    assert optimizer.info.status == Status.INFEASIBLE
    with pytest.raises(DirectionError):
        optimizer.info.raise_for_status()


def test_parameters_large_and_small_of_two_dtypes_are_projected_as_one() -> None:
    """Where some lie alone and others side by side; channels last, and one without a gradient in the first step."""
    torch.manual_seed(0)
    shapes = [(300, 300), (3,), (2, 2, 2, 2), (5,)]
    parameters = [torch.nn.Parameter(torch.randn(shape)) for shape in shapes]
    parameters[2].data = parameters[2].data.to(memory_format=torch.channels_last)
    parameters.append(torch.nn.Parameter(torch.randn(4, dtype=torch.float64)))
    goals = [torch.randn_like(each) for each in parameters]
    optimizer = ConstrainedOptimizer(torch.optim.Adam(parameters, lr=0.01), FORMULATIONS["restoring"])

    def cost() -> Any:
        return sum((each * goal).sum().double() for each, goal in zip(parameters, goals, strict=True))

    for last in (4, 5):
        before = cost().item()
        optimizer.zero_grad()
        optimizer.constrain([cost()], thresholds=[before - 1.0])
        sum((each**2).sum().double() for each in parameters[:last]).backward()
        optimizer.step()
        assert optimizer.info.status == Status.OPTIMAL
        assert cost().item() == pytest.approx(before - 0.5, abs=1e-3)


def test_a_proposal_without_an_answer_is_told() -> None:
    p = torch.nn.Parameter(torch.zeros(2, dtype=torch.float64))

    def move(step: ConstrainedStep) -> Any:
        optimizer = ConstrainedOptimizer(torch.optim.Adam([p], lr=0.1), step)
        optimizer.constrain({"up": p[0] + 1.0, "down": 1.0 - p[0]}, thresholds={"up": 0.0, "down": 0.0})
        p.sum().backward()
        optimizer.step()
        return optimizer.info

    info = move(ConstrainedStep(formulation="restoring"))
    assert (info.status, info.active) == (Status.INFEASIBLE, {"up": True, "down": True})
    assert info.residuals is None
    with pytest.raises(DirectionError, match="INFEASIBLE"):
        info.raise_for_status()
    before = p.detach().clone()
    info = move(ConstrainedStep(formulation="restoring", solver=Silent(), on_failure="skip"))
    assert (info.status, info.counts["skipped"]) == (Status.UNCERTIFIED, 1)
    with pytest.raises(DirectionError):
        move(ConstrainedStep(formulation="restoring", solver=Silent(), on_failure="raise"))
    assert torch.equal(p, before)


class Silent:
    """A solver that never has an answer."""

    def solve(self, problem: Any) -> Direction:
        return Direction.nothing(problem.n, problem.m, Status.ITERATION_LIMIT)


WRONG_SETTINGS = {
    "optimizer should be one of torch.optim": lambda o: (o.parameters, ConstrainedStep()),
    "step should be a ConstrainedStep": lambda o: (o, "cone"),
    "step should have no radius": lambda o: (o, ConstrainedStep(radius=1.0)),
    "step should have no metric": lambda o: (o, ConstrainedStep(metric=[1.0, 2.0])),
}


@pytest.mark.parametrize("message", WRONG_SETTINGS)
def test_wrong_settings_are_refused(message: str) -> None:
    plain = torch.optim.SGD([torch.nn.Parameter(torch.ones(2))], lr=0.1)
    plain.parameters = None
    with pytest.raises(ValueError, match=message):
        ConstrainedOptimizer(*WRONG_SETTINGS[message](plain))


@pytest.mark.parametrize(
    ("message", "spoil"),
    [
        ("constrain should be called before each step", lambda _, o: setattr(o, "_asked", None)),
        ("gradients of the objective should be finite", lambda task, _: task.parameters[0].grad.fill_(np.nan)),
        ("the optimiser's proposal should be finite", lambda _, o: o.param_groups[0].update(lr=np.inf)),
        ("metric should be positive; found -1", lambda _, o: setattr(o, "metric", lambda p: -torch.ones_like(p))),
        ("metric should have shape", lambda _, o: setattr(o, "metric", lambda _: torch.ones(7))),
    ],
)
def test_what_fails_moves_no_parameter(message: str, spoil: Any) -> None:
    task = Task(0, torch.float64)
    optimizer = ConstrainedOptimizer(torch.optim.SGD(task.parameters, lr=0.1), FORMULATIONS["cone"])
    optimizer.constrain(task.costs(), thresholds=task.thresholds)
    task.loss().backward()
    before = task.numbers()
    spoil(task, optimizer)
    with pytest.raises(ValueError, match=message):
        optimizer.step()
    np.testing.assert_array_equal(task.numbers(), before)


def test_a_constraint_that_is_not_finite_is_named() -> None:
    task = Task(0, torch.float64)
    optimizer = ConstrainedOptimizer(torch.optim.SGD(task.parameters, lr=0.1), FORMULATIONS["cone"])
    costs = {"fine": task.costs()[0], "broken": task.costs()[1] * np.nan}
    with pytest.raises(ValueError, match=r"constraints\['broken'\] should have a finite gradient"):
        optimizer.constrain(costs, values=[0.0, 0.0], thresholds=[0.0, 0.0])


@pytest.mark.parametrize("name", ["Adam", "foreach", "NAdam", "Adamax", "RMSprop", "Adagrad"])
def test_a_closure_that_once_gives_nan_does_not_stay_in_the_moments(name: str) -> None:
    task, losses = Task(0, torch.float64), [float("nan"), 1.0]
    optimizer = ConstrainedOptimizer(OPTIMIZERS[name](task.parameters), FORMULATIONS["linearized"])

    def closure() -> Any:
        optimizer.zero_grad()
        optimizer.constrain(task.costs(), thresholds=task.thresholds)
        loss = losses.pop(0) * task.loss()
        loss.backward()
        return loss

    with pytest.raises(ValueError, match="finite"):
        optimizer.step(closure)
    before = task.numbers()
    optimizer.step(closure)
    assert np.isfinite(task.numbers()).all()
    assert (task.numbers() != before).any()


@pytest.mark.parametrize("name", ["SGD", "Adam", "NAdam", "Adamax", "RMSprop", "Adagrad"])
def test_what_only_a_constraint_reaches_has_the_rates_metric(name: str) -> None:
    """1e-6 of a parameter helps a constraint: where its H were eps/lr the whole correction would go there."""
    p, q = (torch.nn.Parameter(torch.tensor([start], dtype=torch.float64)) for start in (1.0, 0.0))
    optimizer = ConstrainedOptimizer(OPTIMIZERS[name]([p, q]), ConstrainedStep(formulation="linearized", step_size=1.0))
    optimizer.constrain([(p + 1e-6 * q).sum()], thresholds=[0.5])
    (p - 3.0).square().sum().backward()
    optimizer.step()
    assert abs(float(q.detach())) < 1e-4


class Watch(TorchDispatchMode):  # type: ignore[misc]
    """The most numbers that gradients, and products made of them, hold at a time."""

    def __init__(self, gradients: list[Any]) -> None:
        super().__init__()
        self.known, self.most = [*map(weakref.ref, gradients)], 0

    def __torch_dispatch__(self, function: Any, types: Any, arguments: Any = (), settings: Any = None) -> Any:
        made = function(*arguments, **(settings or {}))
        if function is torch.ops.aten.mul.Tensor:
            self.known.append(weakref.ref(made))
        self.known = [each for each in self.known if each() is not None]
        self.most = max(self.most, sum({id(each()): each().numel() for each in self.known}.values()))
        return made


@pytest.mark.parametrize("batched", [False, True])
def test_there_is_never_a_second_matrix_beside_the_gradients(batched: bool) -> None:
    count, pieces, m = 1 << 16, 6, 4
    parameters = [torch.nn.Parameter(torch.ones(count)) for _ in range(pieces)]
    optimizer = ConstrainedOptimizer(torch.optim.SGD(parameters, lr=0.1), FORMULATIONS["cone"], metric=torch.ones_like)
    costs = torch.stack([sum((k + each.square()).mean() for each in parameters) for k in range(m)])
    optimizer.constrain(costs, thresholds=m * [0.0], batched=batched)
    sum(each.mean() for each in parameters).backward()
    parts = [part for row in optimizer._asked.gradients for part in row.values()]
    watch = Watch([part._base if batched else part for part in parts])
    del parts
    with watch:
        optimizer.step()
    assert m * pieces * count <= watch.most <= m * (pieces + 1) * count + count
