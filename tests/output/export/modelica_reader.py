"""A Modelica model as pymoca parses and flattens it, run by an interpreter that knows nothing of what it means.

Expressions become functions of a dictionary of values. Between events the states follow by Runge and Kutta's fourth
order in equal steps; a `when` fires at the instant, found by halving, at which one of its conditions becomes true.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import pytest

Values = dict[str, float]
Function = Callable[[Values, Values], Any]  # of the values now, and of those before the event

_OPERATORS: dict[str, Callable[..., Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, ">": operator.gt,
    "<": operator.lt, "==": operator.eq, "and": lambda a, b: a and b, "cos": math.cos, "sin": math.sin,
    "abs": abs,
}  # fmt: skip


class ModelicaModel:
    """One model: its parameters, its states at their starts, and the time that goes on under a held input."""

    def __init__(self, text: str, name: str, **starts: float) -> None:
        parser = pytest.importorskip("pymoca.parser")
        from pymoca import ast, tree

        self.ast = ast
        parsed = parser.parse(text)
        assert parsed is not None, "pymoca finds a syntax error"
        flat = tree.flatten(parsed, ast.ComponentRef(name=name)).classes[name]
        self.symbols = flat.symbols
        self.values: Values = {"time": 0.0}
        for key, symbol in flat.symbols.items():
            given = symbol.value if "parameter" in symbol.prefixes else symbol.start
            self.values[key] = float(starts.get(key, _constant(given)))
        self.states: list[tuple[str, Function, Function]] = []  # name, what its derivative is multiplied by, of it
        self.assigned: list[tuple[str, Function]] = []
        self.whens: list[tuple[list[Function], list[tuple[str, Function]]]] = []
        for equation in flat.equations:
            self._take(equation)
        self._assign(self.values)
        for equation in flat.initial_equations:
            self.values[equation.left.name] = self._function(equation.right)(self.values, self.values)
        self._assign(self.values)
        self.held = [[bool(c(self.values, self.values)) for c in conditions] for conditions, _ in self.whens]

    def advance(self, seconds: float, steps: int, **inputs: float) -> None:
        """Go on in time with inputs that are held."""
        self.values |= inputs
        self._events()
        for _ in range(steps):
            left = seconds / steps
            while left > 0:
                left -= self._until_event(left)

    def _until_event(self, step: float) -> float:
        """Take a step, or the part of it up to the first event, and return how long it was."""
        before = dict(self.values)
        self._step(step)
        if not self._fired():
            self._hold()
            return step
        early, late = 0.0, step
        while late - early > 1e-12 * step:
            middle = 0.5 * (early + late)
            self.values = dict(before)
            self._step(middle)
            early, late = (early, middle) if self._fired() else (middle, late)
        self.values = dict(before)
        self._step(late)
        self._events()
        return late

    def _events(self) -> None:
        """Fire what has become true, until nothing does any more."""
        self._assign(self.values)
        for _ in range(20):
            fired = self._fired()
            self._hold()
            if not fired:
                return
            before = dict(self.values)
            for place in fired:
                for name, function in self.whens[place][1]:
                    self.values[name] = function(self.values, before)
            self._assign(self.values)
        pytest.fail("the events go on for ever")

    def _fired(self) -> list[int]:
        """Return the places of those whens of which a condition is true that was not."""
        now = self._conditions()
        return [i for i, row in enumerate(now) if any(n and not h for n, h in zip(row, self.held[i], strict=True))]

    def _hold(self) -> None:
        self.held = self._conditions()

    def _conditions(self) -> list[list[bool]]:
        return [[bool(c(self.values, self.values)) for c in conditions] for conditions, _ in self.whens]

    def _step(self, h: float) -> None:
        start = dict(self.values)

        def slopes(at: Values) -> Values:
            self._assign(at)
            return {name: right(at, at) / factor(at, at) for name, factor, right in self.states}

        def moved(by: Values, time: float) -> Values:
            gone = {"time": start["time"] + time}
            return start | {name: start[name] + time * slope for name, slope in by.items()} | gone

        one = slopes(start)
        two = slopes(moved(one, h / 2))
        three = slopes(moved(two, h / 2))
        four = slopes(moved(three, h))
        mean = {n: (one[n] + 2 * two[n] + 2 * three[n] + four[n]) / 6 for n in one}
        self.values = moved(mean, h) | {"time": start["time"] + h}
        self._assign(self.values)

    def _assign(self, values: Values) -> None:
        for name, function in self.assigned:
            values[name] = function(values, values)

    def _take(self, equation: Any) -> None:
        ast = self.ast
        if isinstance(equation, ast.WhenEquation):
            (condition,), (block,) = equation.conditions, equation.blocks
            effects = [self._effect(one) for one in block]
            self.whens.append(([self._function(c) for c in condition.values], effects))
        elif isinstance(equation.left, ast.ComponentRef):
            self.assigned.append((equation.left.name, self._function(equation.right)))
        else:  # der(x) = ..., or factor * der(x) = ...
            left = equation.left
            factor, derivative = (ast.Primary(value=1.0), left) if left.operator == "der" else left.operands
            assert derivative.operator == "der"
            name = derivative.operands[0].name
            self.states.append((name, self._function(factor), self._function(equation.right)))

    def _effect(self, equation: Any) -> tuple[str, Function]:
        if isinstance(equation, self.ast.Equation):
            return equation.left.name, self._function(equation.right)
        assert equation.name == "reinit"
        return equation.arguments[0].name, self._function(equation.arguments[1])

    def _function(self, node: Any) -> Function:
        ast = self.ast
        if isinstance(node, ast.Primary):
            constant = node.value
            return lambda now, before: constant
        if isinstance(node, ast.ComponentRef):
            name = node.name
            assert name == "time" or name in self.symbols, f"{name} is not declared"
            return lambda now, before: now[name]
        if isinstance(node, ast.IfExpression):
            condition, (one, other) = self._function(node.conditions[0]), map(self._function, node.expressions)
            assert len(node.conditions) == 1
            return lambda now, before: one(now, before) if condition(now, before) else other(now, before)
        called = node.operator if isinstance(node.operator, str) else node.operator.name
        parts = [self._function(operand) for operand in node.operands]
        if called == "pre":
            return lambda now, before: parts[0](before, before)
        if called == "-" and len(parts) == 1:
            return lambda now, before: -parts[0](now, before)
        apply = _OPERATORS[called]
        return lambda now, before: apply(*(part(now, before) for part in parts))


def _constant(node: Any) -> float:
    """Return a number, which may have a minus before it; 0 where there is none."""
    if hasattr(node, "operands"):
        assert node.operator == "-"
        return -_constant(node.operands[0])
    return 0.0 if node.value is None else node.value
