"""docs/kinds.md: its examples run, and its numbers are those of the code."""

import re
import textwrap
from pathlib import Path

import numpy as np

from cpgrl_opt import ConstrainedStep, DirectionProblem, Linearization, kkt_residuals, solve
from cpgrl_opt.vectors import Sharded

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/kinds.md").read_text(encoding="utf-8")
G, J, B = np.array([1.0, 2.0, -0.5]), np.array([[-1.0, 0.0, 0.0], [0.0, -1.0, 1.0]]), np.array([0.0, 0.5])


def examples():
    return re.findall(r"```python\n(.*?)```", PAGE, re.S)


def test_the_kind_of_files_runs_as_printed(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, vector in zip(("g", "row1", "row2"), (G, *J), strict=True):
        np.save(f"{name}.npy", vector)
    names = {}
    exec(examples()[0], names)
    assert capsys.readouterr().out.startswith("OPTIMAL [")
    np.testing.assert_allclose(np.load(names["direction"].value), solve(DirectionProblem(G, J, B)).value, atol=1e-12)
    kind = names["Files"]("g.npy", "row1.npy", "row2.npy")
    change = ConstrainedStep()(Linearization([0.0, -1.0, -1.0], kind), [0.0, 0.0]).change
    assert np.load(change).shape == (3,)
    written = [line for line in textwrap.dedent(examples()[0]).splitlines() if line.strip()]
    assert len(written) <= 24  # with its imports and the call


def test_the_example_of_processes_runs_in_one():
    example = examples()[1].replace("my_part_of_J)", "my_part_of_J, gather=lambda mine: [mine])")
    names = {"DirectionProblem": DirectionProblem, "solve": solve, "my_part_of_g": G, "my_part_of_J": J, "b": B}
    exec(example, names)
    np.testing.assert_allclose(names["my_part_of_d"], solve(DirectionProblem(G, J, B)).value, atol=1e-12)


def test_what_a_solve_sends_is_as_written():
    sent = []

    def gather(mine):
        sent.append(mine.nbytes)
        return [mine]

    problem = DirectionProblem(Sharded(G, J, gather=gather), bound=B)
    answer, m = solve(problem), len(J)
    (formula,) = re.findall(r"three times (8 · \(2 \+ 3 \(1 \+ m\) \+ 2 \(1 \+ m\)²\)) bytes", PAGE)
    each = eval(re.sub(r"(\d) \(", r"\1 * (", formula).replace("·", "*").replace("²", "**2"), {"m": m})
    assert sent == [32, each, each, each]
    kkt_residuals(problem, answer)
    assert sent[4:] == [each, each]
