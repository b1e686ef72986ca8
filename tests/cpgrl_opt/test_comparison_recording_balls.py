"""Recordings of steps with a radius: tangents in their ball, restorations without one, and files of either kind."""

from dataclasses import replace

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, ConstrainedStep, Linearization, Status
from cpgrl_opt.comparison.recorded_family import make_recorded_family
from cpgrl_opt.comparison.recorder import Recorder, stretches
from cpgrl_opt.comparison.recording import PARTS, Recording, join, load_recording, shipped_recording

RUNS, EPISODES, N = 3, 6, 4
RADIUS = 0.25


def watched(step: ConstrainedStep, runs: tuple[int, ...] = tuple(range(RUNS))) -> tuple[Recording, list]:
    """A little training on random gradients, and all batches that the step handed on."""
    recorder, calls = Recorder(runs, stretches(10_000, RUNS, EPISODES), "toy"), []

    def observe(problems, answers) -> None:
        calls.append(problems)
        recorder(problems, answers)

    rng = np.random.default_rng(0)
    for _ in range(EPISODES):
        values, gradients = rng.standard_normal((RUNS, 3)) - 0.3, rng.standard_normal((RUNS, 3, N))
        if step.drop == "always":
            gradients[:, 0] = gradients[:, 1]  # so that λ of constraint 1 is positive: it is dropped
        step(Linearization(values[list(runs)], gradients[list(runs)]), [0.0, 0.0], None, observe)
        recorder.next_episode()
    return recorder.recording(), calls


def parts_of(recording: Recording) -> dict[str, set[float]]:
    """The radii met, by part."""
    return {name: set(recording.radii[recording.part == k].tolist()) for k, name in enumerate(PARTS)}


@pytest.mark.parametrize("formulation", ["equality", "cone"])
@pytest.mark.parametrize("metric", [None, np.arange(1.0, N + 1.0)])
def test_tangents_are_kept_with_their_radius_and_restorations_without(formulation, metric) -> None:
    recording, calls = watched(ConstrainedStep(formulation=formulation, radius=RADIUS, metric=metric, drop="never"))
    assert parts_of(recording) == {
        "tangent": {RADIUS}, "restoration": {np.inf}, "tangent after a drop": set(), "restoration after a drop": set(),
    }  # fmt: skip
    kept = {(problem.gradient.tobytes(), problem.jacobian.tobytes(), problem.radius) for problem in recording.problems}
    met = [problem for batch in calls for problem in batch if (problem.bound > -np.inf).any()]
    assert kept == {(problem.gradient.tobytes(), problem.jacobian.tobytes(), problem.radius) for problem in met}
    assert all(problem.metric is None for problem in recording.problems)


@pytest.mark.parametrize("formulation", ["restoring", "linearized"])
def test_a_formulation_that_restores_inside_has_tangents_only(formulation) -> None:
    recording, _ = watched(ConstrainedStep(formulation=formulation, radius=RADIUS))
    assert parts_of(recording)["tangent"] == {RADIUS}
    assert set(recording.part.tolist()) == {0}


def test_a_file_gives_the_radius_back_and_others_are_written_as_ever(tmp_path) -> None:
    recording, _ = watched(ConstrainedStep(formulation="cone", radius=RADIUS))
    recording.save(tmp_path / "balls.npz")
    again = load_recording(tmp_path / "balls.npz")
    np.testing.assert_array_equal(again.radii, recording.radii)
    assert [problem.radius for problem in again.problems] == [problem.radius for problem in recording.problems]
    plain, _ = watched(ConstrainedStep(formulation="cone"))
    plain.save(tmp_path / "plain.npz")
    with np.load(tmp_path / "plain.npz") as file, np.load(tmp_path / "balls.npz") as other:
        assert "radius" not in file.files
        assert (str(file["format"]), str(other["format"])) == ("cpgrl recording 1", "cpgrl recording 2")


def test_the_shipped_files_have_no_balls() -> None:
    recording = shipped_recording("three-state")
    assert (recording.radii == np.inf).all()
    assert recording.batch.radius is None
    assert recording.problems[0].radius is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": np.array("cpgrl recording 1")}, "format should be 'cpgrl recording 2'; found 'cpgrl recording 1'"),
        ({"radius": None}, "format should be 'cpgrl recording 1'; found 'cpgrl recording 2'"),
        ({"radius": -1.0}, "radius should hold .* numbers > 0"),
        ({"radius": np.nan}, "radius should hold .* numbers > 0"),
    ],
)
def test_a_file_whose_radii_are_wrong_is_refused(change, message, tmp_path) -> None:
    recording, _ = watched(ConstrainedStep(formulation="restoring", radius=RADIUS))
    recording.save(tmp_path / "bad.npz")
    with np.load(tmp_path / "bad.npz") as file:
        contents = dict(file)
    for name, value in change.items():
        contents[name] = np.full(len(recording), value) if isinstance(value, float) else value
    np.savez(tmp_path / "bad.npz", **{name: value for name, value in contents.items() if value is not None})
    with pytest.raises(ValueError, match=message):
        load_recording(tmp_path / "bad.npz")


def test_problems_of_both_kinds_are_no_batch_but_each_kind_is() -> None:
    recording, _ = watched(ConstrainedStep(formulation="cone", radius=RADIUS))
    with pytest.raises(ValueError, match="should all have a radius, or none"):
        _ = recording.batch
    tangents = recording.select(recording.part == 0)
    assert set(tangents.batch.radius.tolist()) == {RADIUS}
    assert recording.select(recording.part == 1).batch.radius is None
    together = join([tangents, recording.select(recording.part == 1)])
    np.testing.assert_array_equal(together.radii, recording.radii)


def test_a_family_of_balls_says_which_of_its_problems_are_feasible() -> None:
    recording, _ = watched(ConstrainedStep(formulation="restoring", radius=RADIUS, restoration_rate=0.5))
    family = make_recorded_family(recording, "own")
    found = {family.is_feasible(problem) for problem in recording.problems}
    assert found == {True, False}
    for problem in recording.problems:
        answer = SOLVERS["active-set"].solve(problem)
        assert family.is_feasible(problem) == (answer.status == Status.OPTIMAL)
    assert not family.feasible
    wide = replace(recording, radius=np.full(len(recording), 1e3))
    assert make_recorded_family(wide, "wide").feasible
