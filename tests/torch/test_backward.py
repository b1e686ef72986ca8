"""`constrained_backward`: what it writes is the change of a step on the same gradients, whatever the loop is like."""

import warnings
from copy import deepcopy
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from cpgrl_opt import FORMULATIONS, ConstrainedStep, Linearization, Status  # noqa: E402
from cpgrl_opt.torch import constrained_backward  # noqa: E402

STEP = ConstrainedStep(formulation="restoring", step_size=0.1)
THRESHOLDS = [-0.5, 0.0]  # one is violated by the outputs of `net`, one is met


def losses(net: Any, batch: Any) -> tuple[Any, list[Any]]:
    loss, *costs = net(batch).mean(dim=0).unbind()
    return loss, costs


def rows(net: Any, batch: Any) -> list[np.ndarray]:
    """−∇ of the loss and of each cost, flat, by PyTorch itself."""
    found = []
    for k in range(3):
        moving = [each for each in net.parameters() if each.requires_grad]
        parts = torch.autograd.grad(net(batch).mean(dim=0)[k], moving)
        found.append(-torch.cat([part.reshape(-1) for part in parts]).numpy())
    return found


def flat_grad(net: Any) -> np.ndarray:
    return torch.cat([each.grad.reshape(-1) for each in net.parameters() if each.requires_grad]).numpy()


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("kind", ["cost", "reward"])
@pytest.mark.parametrize("form", ["list", "dict", "one tensor", "functions", "batched"])
def test_a_plain_gradient_step_is_the_change_of_the_step(
    net: Any, batch: Any, formulation: str, kind: str, form: str
) -> None:
    step = ConstrainedStep(formulation=formulation, step_size=0.1, restoration_rate=0.2)
    sign = 1.0 if kind == "cost" else -1.0
    loss, costs = losses(net, batch)
    values, limits = -np.array([cost.item() for cost in costs]), -np.array(THRESHOLDS)
    expected = step(Linearization([0.0, *values], rows(net, batch)), limits)
    given: Any = [sign * cost for cost in costs]
    thresholds: Any = [sign * each for each in THRESHOLDS]
    if form == "dict":
        given, thresholds = dict(zip("ab", given, strict=True)), {"b": thresholds[1], "a": thresholds[0]}
    if form == "one tensor":
        given = torch.stack(given)
    if form == "functions":
        loss, given = (lambda: losses(net, batch)[0]), [lambda k=k: sign * losses(net, batch)[1][k] for k in range(2)]
    info = constrained_backward(
        loss,
        given,
        thresholds=thresholds,
        parameters=[{"params": net[0].parameters()}, {"params": net[2].parameters(), "lr": 1.0}],
        step=step,
        kind=kind,
        batched=form == "batched",
    )
    before = torch.nn.utils.parameters_to_vector(each for each in net.parameters() if each.requires_grad).detach()
    torch.optim.SGD(net.parameters(), lr=0.1).step()
    after = torch.nn.utils.parameters_to_vector(each for each in net.parameters() if each.requires_grad).detach()
    np.testing.assert_allclose((after - before).numpy(), expected.change, atol=1e-15)
    assert net[0].bias.grad is None
    assert info.status == Status.OPTIMAL
    found = [info.multipliers, info.active, info.predicted_slack, info.slack]
    found = [[*each.values()] if form == "dict" else each for each in found]
    wanted = [expected.multipliers, expected.active, expected.predicted_slack, values - limits]
    for each, other in zip(found, wanted, strict=True):
        np.testing.assert_allclose(each, other, atol=1e-12)
    assert info.residuals is not None
    assert info.residuals.worst <= 1e-9


def test_it_accumulates_and_values_may_be_others_than_those_of_the_tensors(net: Any, batch: Any) -> None:
    for _ in range(2):
        loss, costs = losses(net, batch)
        info = constrained_backward(
            loss, costs, values=[-9.0, -9.0], thresholds=[0, 0], parameters=net.parameters(), step=STEP
        )
    np.testing.assert_allclose(info.slack, [9.0, 9.0])
    np.testing.assert_allclose(flat_grad(net), -2.0 * rows(net, batch)[0], atol=1e-14)


def test_no_constraint_is_a_plain_backward(net: Any, batch: Any) -> None:
    constrained_backward(losses(net, batch)[0], [], thresholds=[], parameters=net.parameters(), step=STEP)
    np.testing.assert_allclose(flat_grad(net), -rows(net, batch)[0], atol=1e-15)


def test_heads_shared_and_unused_parameters_of_mixed_dtypes() -> None:
    """A head of its own for each channel, one weight used twice, one not at all; float32 beside bfloat16."""
    torch.manual_seed(0)
    trunk, unused = torch.nn.Parameter(torch.randn(3, 3)), torch.nn.Parameter(torch.randn(2))
    heads = [torch.nn.Parameter(torch.randn(3).to(torch.bfloat16)) for _ in range(3)]
    x = trunk @ trunk @ torch.ones(3)
    loss, *costs = (x.to(torch.bfloat16) @ head for head in heads)
    parameters = [trunk, unused, *heads]
    constrained_backward(loss, costs, values=[1.0, -1.0], thresholds=[0.0, 0.0], parameters=parameters, step=STEP)
    assert unused.grad is None
    assert [each.grad.dtype for each in (trunk, *heads)] == [torch.float32] + 3 * [torch.bfloat16]
    assert [bool(head.grad.any()) for head in heads] == [True, True, False]  # the second cost is met


def wrong_calls(net: Any, batch: Any) -> dict[str, tuple[str, dict[str, Any]]]:
    loss, costs = losses(net, batch)
    gone, _ = losses(net, batch)
    gone.backward()
    net.zero_grad()
    (first, *_), complex_ = net.parameters(), torch.nn.Parameter(torch.ones(2, dtype=torch.complex128))
    integer = torch.ones(2, dtype=torch.int64)
    nan = (first * torch.tensor(float("nan"))).sum()
    elsewhere = torch.nn.Parameter(torch.ones(2, device="meta"))
    half = torch.nn.Parameter(torch.ones(2, dtype=torch.float16))
    table = torch.nn.Embedding(3, 2, sparse=True)
    looked_up = table(torch.tensor([0])).sum()
    rate = torch.ones((), dtype=torch.float64)
    written_to = (first * rate).sum()
    rate.mul_(2.0)
    single = torch.nn.Parameter(torch.ones(2))
    return {
        "NaN in a gradient": ("constraints.1. should have a finite gradient", {"constraints": [costs[0], nan]}),
        "NaN in the loss": ("objective should have a finite gradient", {"objective": nan}),
        "no gradient": ("objective should depend on the parameters", {"objective": loss.detach()}),
        "other parameters": (
            "constraints.0. should depend",
            {"constraints": [torch.ones(2, requires_grad=True).sum(), costs[0]]},
        ),
        "graph freed": ("objective should have a graph that is still there", {"objective": gone}),
        "devices": ("parameters should be on one device", {"parameters": [first, elsewhere]}),
        "half": (
            "torch.float32, torch.bfloat16; found that number 0 is of torch.float16",
            {"parameters": [half], "objective": half.sum(), "constraints": [], "thresholds": []},
        ),
        "complex": ("parameters should be real", {"parameters": [complex_]}),
        "sparse": (
            "constraints.0. should have dense gradients.*parameter number 1",
            {"constraints": [looked_up.double() + costs[0], costs[1]], "parameters": [first, table.weight]},
        ),
        "sparse, batched": (
            "constraints.1. should have dense gradients",
            {"constraints": [costs[0], looked_up.double()], "parameters": [first, table.weight], "batched": True},
        ),
        "written to": ("constraints.1. should have a graph whose", {"constraints": [costs[0], written_to]}),
        "written to, batched": (
            "constraints.1. should have a graph whose",
            {"constraints": [costs[0], written_to], "batched": True},
        ),
        "out of reach": (
            "constraints.0. should be restored by a change that is finite",
            {"parameters": [single], "objective": single.sum(), "constraints": [1e-42 * single.sum()]}
            | {"values": [1.0], "thresholds": [0.0]},
        ),
        "integer": (
            "parameters should be floating-point .* number 1 is of torch.int64",
            {"parameters": [first, integer]},
        ),
        "frozen": ("should have one that requires a gradient", {"parameters": [net[0].bias]}),
        "twice": ("found one twice", {"parameters": [first, first]}),
        "no leaf": ("should be leaf tensors", {"parameters": [2.0 * first]}),
        "no tensors": ("parameters should be tensors", {"parameters": [1.0]}),
        "thresholds": ("thresholds should have shape", {"thresholds": [1.0]}),
        "names": ("thresholds should be in order", {"thresholds": {"a": 1.0, "b": 2.0}}),
        "other names": (
            "thresholds should be named a, b; found a, c",
            {"constraints": dict(zip("ab", costs, strict=True)), "thresholds": {"a": 1.0, "c": 2.0}},
        ),
        "values": ("values should be finite", {"values": [1.0, float("nan")]}),
        "shape": ("objective should be one real number", {"objective": net(batch)}),
        "kind": ("kind should be one of cost, reward", {"kind": "costs"}),
        "step": ("step should be a ConstrainedStep", {"step": "restoring"}),
        "rate": ("step_size of step should be > 0", {"step": ConstrainedStep(step_size=0.0)}),
        "list": ("constraints should be a list or a dict", {"constraints": 3.0, "thresholds": 1.0}),
        "number": ("constraints.0. should be a tensor", {"constraints": [1.0, 2.0]}),
    }


WRONG = [
    "NaN in a gradient", "NaN in the loss", "no gradient", "other parameters", "graph freed", "written to",
    "written to, batched", "sparse", "sparse, batched", "out of reach", "devices", "half", "complex", "integer",
    "frozen", "twice", "no leaf", "no tensors", "thresholds", "names", "other names", "values", "shape", "kind",
    "step", "rate", "list", "number",
]  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_bad_input_is_an_error_and_nothing_is_written(net: Any, batch: Any, what: str) -> None:
    message, changed = wrong_calls(net, batch)[what]
    loss, costs = losses(net, batch)
    before = deepcopy(net.state_dict())
    usual = {"objective": loss, "constraints": costs, "thresholds": THRESHOLDS, "parameters": net.parameters()}
    with pytest.raises(ValueError, match=message):
        constrained_backward(**{**usual, "step": STEP, **changed})
    assert all(each.grad is None for each in net.parameters())
    assert all(torch.equal(each, before[name]) for name, each in net.state_dict().items())


def test_compiled_code_may_surround_it(net: Any, batch: Any) -> None:
    def train(batch: Any) -> Any:
        loss, *costs = net(batch).mean(dim=0).unbind()
        constrained_backward(loss, costs, thresholds=THRESHOLDS, parameters=net.parameters(), step=STEP)
        return 2.0 * loss

    plain = train(batch).item()
    expected = flat_grad(net).copy()
    net.zero_grad()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the compiler says of itself
        assert torch.compile(train, backend="aot_eager")(batch).item() == pytest.approx(plain)
    np.testing.assert_allclose(flat_grad(net), expected, atol=1e-14)


def test_parameters_are_taken_as_optimisers_take_them(net: Any, batch: Any) -> None:
    """Tensors, named ones, and groups of both."""
    step, grads = ConstrainedStep(formulation="linearized"), []
    for given in (net.parameters(), net.named_parameters(), [{"params": net.named_parameters(), "lr": 0.1}]):
        net.zero_grad()
        out = net(batch).square().mean(dim=0)
        constrained_backward(out[0], [out[1]], thresholds=[0.0], parameters=given, step=step)
        grads.append([each.grad for each in net.parameters()])
    for other in grads[1:]:
        assert all(a is b is None or torch.equal(a, b) for a, b in zip(grads[0], other, strict=True))


@pytest.mark.parametrize("batched", [False, True])
def test_hooks_of_parameters_see_gradients_as_backward_shows_them(batched: bool) -> None:
    w = torch.nn.Parameter(torch.tensor([1.0, -2.0]))
    w.register_hook(lambda gradient: gradient.clamp(min=0.0))
    constrained_backward(
        (w**2).sum(), [w.sum()], thresholds=[100.0], parameters=[w], step=ConstrainedStep(), batched=batched
    )
    torch.testing.assert_close(w.grad, torch.tensor([2.0, 0.0]))
