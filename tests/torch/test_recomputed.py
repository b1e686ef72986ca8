"""`chunks`: the update of gradients that are all there, by gradients of which only some are at a time."""

from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from cpgrl_opt import FORMULATIONS, ConstrainedStep, Status  # noqa: E402
from cpgrl_opt.torch import constrained_backward  # noqa: E402


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("chunks", [1, 2, 9])
@pytest.mark.parametrize("functions", [True, False])
def test_it_is_the_usual_update(net: Any, batch: Any, formulation: str, chunks: int, functions: bool) -> None:
    step = ConstrainedStep(formulation=formulation, step_size=0.1, restoration_rate=0.5)
    found = []
    for each in (None, chunks):
        net.zero_grad()
        loss, *costs = net(batch).mean(dim=0).unbind()
        if functions:
            loss, costs = (lambda: net(batch).mean(dim=0)[0]), [lambda k=k: net(batch).mean(dim=0)[k] for k in (1, 2)]
        where = {"parameters": net.parameters(), "step": step, "chunks": each}
        info = constrained_backward(loss, costs, thresholds=[-0.5, -0.1], **where)
        assert info.status == Status.OPTIMAL
        found.append(torch.cat([p.grad.reshape(-1) for p in net.parameters() if p.requires_grad]).numpy())
    np.testing.assert_allclose(found[1], found[0], atol=1e-12)


def test_what_does_not_go_with_it_is_refused(net: Any, batch: Any) -> None:
    where = {"thresholds": [], "parameters": [*net.parameters()], "step": ConstrainedStep()}
    for wrong in ({"chunks": 2, "batched": True}, {"chunks": 0}, {"chunks": 1.5}):
        with pytest.raises(ValueError, match="chunks should be"):
            constrained_backward(net(batch).sum(), [], **where, **wrong)
    with pytest.raises(ValueError, match="finite"):
        constrained_backward(net(batch).sum() * np.nan, [], **where, chunks=2)
    assert all(each.grad is None for each in net.parameters())
