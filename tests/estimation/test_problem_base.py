"""What problems of one record share: values and vectors by name, parameters kept and freed."""

from dataclasses import dataclass

import numpy as np

from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.problems.base import RecordProblem
from jointid.models.joints import Joint, RigidJoint
from jointid.records.signals.filtering import Filtering

Array = np.ndarray
TIME = np.linspace(0.0, 1.0, 50)


@dataclass(frozen=True, slots=True, eq=False)
class Line(RecordProblem):
    """``measured = a + b t``, as the smallest problem that there is."""

    @property
    def joint(self) -> Joint:
        return RigidJoint("prismatic")

    def filter(self, columns: Array) -> Array:
        return columns

    def residual(self, x: Array) -> Array:
        values = self.values(x)
        return self.measured - values["a"] - values["b"] * TIME

    def linearise(self, x: Array) -> tuple[Array, Array]:
        columns = {"a": np.ones_like(TIME), "b": TIME}
        return self.residual(x), -np.column_stack([columns[p.name] for p in self.free])


def line(a: float, b: float) -> Line:
    parameters = (Parameter("a", "a", Quantity.FORCE, start=0.5), Parameter("b", "b", Quantity.FORCE))
    return Line(parameters, a + b * TIME, Filtering())


def test_values_and_vector_are_each_others_inverse() -> None:
    problem = line(1.0, 2.0)
    assert problem.values(np.array([3.0, 4.0])) == {"a": 3.0, "b": 4.0}
    assert list(problem.vector({"b": 4.0})) == [0.5, 4.0]
    kept = problem.keeping({"a": 1.0, "unknown": 9.0})
    assert [p.name for p in kept.free] == ["b"]
    assert kept.values(np.array([4.0])) == {"a": 1.0, "b": 4.0}
    assert list(kept.vector({"a": 7.0, "b": 4.0})) == [4.0]
    assert [p.name for p in kept.all_free().free] == ["a", "b"]
    assert [p.name for p in problem.free] == ["a", "b"]  # it is another problem, and this one is as it was
