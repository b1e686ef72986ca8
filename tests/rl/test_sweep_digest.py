"""What a training is made from decides a sweep's keys: whatever differs, differs there; what is made anew does not."""

import enum
import functools
import json
import math
import os
import re
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep
from rl import CPGRL, uniform_parameters
from rl.digest import digest_of

RATE, FACTORS = 0.1, {"a": 1.0}


class Colour(enum.Enum):
    RED, BLUE = 1, 2


class Slotted:
    __slots__ = ("_rate", "other")

    def __init__(self, rate):
        self._rate = rate


class Rule:
    def __init__(self, *rates):
        self._rates = [*rates]

    def scale(self, x):
        return x * self._rates[0]

    @functools.cached_property
    def total(self):
        return sum(self._rates)

    @staticmethod
    def again(rate):
        return Rule(rate)


class OtherRule(Rule):
    def scale(self, x):
        return x + self._rates[0]


@dataclass
class Nested:
    inner: object


@functools.cache
def remembered(x):
    return RATE * x


def dispatching(rate):
    @functools.singledispatch
    def scale(x):
        return x

    scale.register(int, lambda x: x * rate)
    scale(2)  # is remembered
    return scale


@numba.njit
def compiled(x):
    return 2.0 * x


def with_helper(rate):
    def helper(x):
        return x * rate

    return lambda seed: helper(seed)


def counting_down(rate):
    def count(n):
        return rate if n == 0 else count(n - 1)

    return count


def holding_itself(rate):
    found = Rule(rate)
    found.me = found
    return found


def pairs():
    """By name, two things that differ."""
    return {
        "numbers": (1, 1.0),
        "truth": (1, True),
        "signs": (0.0, -0.0),
        "text": ("1", b"1"),
        "enumeration": (Colour.RED, Colour.BLUE),
        "set": (frozenset([("a", "b"), "c", Colour.RED]), frozenset([("a", "b"), "c", Colour.BLUE])),
        "tuple": ((1, 2), [1, 2]),
        "dict": ({"a": 1, "b": 2}, {"b": 2, "a": 1}),
        "keys": ({1: "x"}, {"1": "x"}),
        "array": (np.arange(100.0), np.arange(100.0)[::-1]),
        "type of an array": (np.float32([1, 2]), np.float64([1, 2])),
        "objects in an array": (np.array([Rule(1)], dtype=object), np.array([Rule(2)], dtype=object)),
        "generator": (np.random.default_rng(1), np.random.default_rng(2)),
        "slots": (Slotted(1), Slotted(2)),
        "nested": (Nested(Nested(Rule(1, 2))), Nested(Nested(Rule(1, 3)))),
        "class": (Rule, OtherRule),
        "class of an object": (Rule(1), OtherRule(1)),
        "bound method": (Rule(1).scale, Rule(2).scale),
        "static method": (Rule.again, OtherRule.scale),
        "function": (math.sin, math.cos),
        "operation of NumPy": (np.add, np.multiply),
        "partial": (functools.partial(max, 1), functools.partial(max, 2)),
        "lambda": (lambda x: x in {"a", "b", "c"}, lambda x: x in {"a", "b", "d"}),
        "default": (lambda x, rate=1: x * rate, lambda x, rate=2: x * rate),
        "keyword": (lambda x, *, rate=1: x * rate, lambda x, *, rate=2: x * rate),
        "helper's closure": (with_helper(1), with_helper(2)),
        "recursion": (counting_down(1), counting_down(2)),
        "cycle": (holding_itself(1), holding_itself(2)),
        "within a lambda": (lambda: lambda: RATE, lambda: lambda: FACTORS),
        "attribute of a module": (lambda: math.sin, lambda: math.cos),
        "cached": (remembered, functools.cache(lambda x: x)),
        "dispatching": (dispatching(1), dispatching(2)),
        "compiled": (compiled, numba.njit(lambda x: 3.0 * x)),
        "learner": (CPGRL(ConstrainedStep(solver="rosen"), [0.0]), CPGRL(ConstrainedStep(solver="osqp"), [0.0])),
        "lambda of ours": (uniform_parameters(3), uniform_parameters(3, 0.5)),
    }


def digests(names):
    made = pairs()
    return {name: [digest_of(own, "it") for own in made[name]] for name in names}


def test_what_differs_has_another_digest_and_what_is_made_again_the_same():
    """In a process whose sets have another order, too."""
    code = f"import json, {__name__} as own; print(json.dumps(own.digests(own.pairs())))"
    environment = {**os.environ, "PYTHONHASHSEED": "1", "PYTHONPATH": str(Path(__file__).parents[__name__.count(".")])}
    elsewhere = json.loads(subprocess.check_output([sys.executable, "-c", code], env=environment))
    here = digests(pairs())
    assert [name for name, (first, second) in here.items() if first == second] == []
    assert here == digests(pairs()) == elsewhere


def test_what_a_function_names_counts_as_it_is(monkeypatch, tmp_path):
    (tmp_path / "helpers_of_a_test.py").write_text("RATE = 1\ndef scale(x):\n    return RATE * x\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    import helpers_of_a_test as helpers

    looked_up = [lambda: RATE, remembered, lambda: helpers.scale, helpers.scale, lambda: FACTORS]
    before = [digest_of(own, "it") for own in looked_up]
    monkeypatch.setitem(globals(), "RATE", 0.2)
    monkeypatch.setattr(helpers, "RATE", 2)
    monkeypatch.setitem(FACTORS, "a", 2.0)
    assert all(digest_of(own, "it") != first for own, first in zip(looked_up, before, strict=True))


def test_what_is_only_remembered_does_not_count():
    rule = Rule(1)
    before = digest_of(rule, "it")
    assert rule.total == 1
    assert digest_of(rule, "it") == before


def test_what_has_no_digest_is_refused_by_name():
    def training(seed):
        return lock

    lock = threading.Lock()
    for value, where in ((training, "training"), ([1, (line for line in "ab")], "settings['log']")):
        with pytest.raises(ValueError, match=rf"{re.escape(where)} should be made of what can be pickled"):
            digest_of(value, where)
