"""Under a `GradScaler` all is as without; where a gradient overflows the step is skipped."""

from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from cpgrl_opt import ConstrainedStep, Status  # noqa: E402
from cpgrl_opt.torch import ConstrainedOptimizer, constrained_backward  # noqa: E402

STEP = ConstrainedStep(formulation="restoring", step_size=0.1, restoration_rate=0.5)


def update(way: str, scaler: Any, spoil: float = 1.0) -> tuple[np.ndarray, Any]:
    torch.manual_seed(0)
    p, x = torch.nn.Parameter(torch.ones(3)), torch.randn(3)
    sgd = torch.optim.SGD([p], lr=0.1)
    with torch.autocast("cpu", torch.bfloat16):
        loss, cost = ((p - x) ** 2).sum(), (p * x * spoil).sum()
    if way == "backward":
        optimizer, where = sgd, {"parameters": [p], "step": STEP}
        info = constrained_backward(loss, [cost], values=[1.0], thresholds=[0.5], scaler=scaler, **where)
    else:
        optimizer = ConstrainedOptimizer(sgd, STEP)
        optimizer.constrain([cost], values=[1.0], thresholds=[0.5], scaler=scaler)
        (loss if scaler is None else scaler.scale(loss)).backward()
        info = optimizer.info
    if scaler is None:
        optimizer.step()
    else:
        scaler.step(optimizer)
        scaler.update()
    return p.detach().numpy().copy(), info if way == "backward" else optimizer.info


@pytest.mark.parametrize("way", ["backward", "optimizer"])
def test_a_scaler_changes_nothing_but_what_overflows(way: str) -> None:
    plain, info = update(way, None)
    scaled, told = update(way, torch.amp.GradScaler("cpu", init_scale=2.0**12))
    np.testing.assert_allclose(scaled, plain, rtol=1e-6)
    np.testing.assert_allclose(told.multipliers, info.multipliers, rtol=1e-5)
    assert info.multipliers[0] > 0.0
    np.testing.assert_array_equal(update(way, torch.amp.GradScaler("cpu", enabled=False))[0], plain)
    scaler = torch.amp.GradScaler("cpu", init_scale=2.0**12)
    left, told = update(way, scaler, spoil=1e38)
    np.testing.assert_array_equal(left, np.ones(3))
    assert (told.status, scaler.get_scale()) == (Status.NUMERICAL_ERROR, 2.0**11)
    with pytest.raises(ValueError, match=r"constraints\[0\] should have a finite gradient"):
        update(way, None, spoil=np.inf)
