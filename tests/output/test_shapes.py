"""Every shape of a JSON document is of a class that exists, and finds all that it names in what the class declares."""

from __future__ import annotations

import collections.abc
import dataclasses
import enum
import importlib
import inspect
import pkgutil
import types
import typing
from functools import cache
from typing import Any

import numpy as np
import pytest

import jointid as ji
import jointid.output.json.estimates as of_estimates
from jointid.common.messages import Message
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import EstimatedParameter, RecordFit
from jointid.models.controllers import Cascade, Controller
from jointid.models.disturbances import Effect
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.models.position_forces import PositionHarmonics
from jointid.output.json.documents import SHAPES
from jointid.output.json.estimates import Shape, as_percentage, by_name, take
from jointid.uncertainty.identifiability import Combination, Identifiability, Kind, Known
from jointid.uncertainty.verdict import StiffnessBound

ELSEWHERE = {"jointid.records.drives.Profile"}
"""Classes of the same name as one with a shape, of which no document has an object."""

CASCADE = Cascade(position_gain=1.0, velocity_gain=1.0)
REAL = {
    Controller: CASCADE,
    ClosedLoop: ClosedLoop(RigidJoint("prismatic"), CASCADE),
    Effect: PositionHarmonics(1.0),
}
"""Objects instead of specimens, where a shape asks a function for the keys."""

WHOLE = (EstimatedParameter, Known, Combination, StiffnessBound)
"""Classes of which a shape makes other objects, with some fields replaced."""

OF_ESTIMATES: dict[str, tuple[Shape, type]] = {
    "any": (of_estimates._OF_BOTH, Estimate),
    "a joint": (of_estimates._OF_A_JOINT, Estimate),
    "a log": (of_estimates._LOG, Estimate),
    "a record of several": (of_estimates._RECORD, RecordFit),
}


@cache
def _classes() -> dict[str, list[type]]:
    """Return all data classes of the package by name."""
    found: dict[str, list[type]] = {}
    for module in pkgutil.walk_packages(ji.__path__, "jointid."):
        for one in vars(importlib.import_module(module.name)).values():
            if inspect.isclass(one) and one.__module__ == module.name and dataclasses.is_dataclass(one):
                found.setdefault(one.__name__, []).append(one)
    return found


class Specimen:
    """An object of a class, as far as its annotations tell: it has their attributes, and no others."""

    def __init__(self, kind: type) -> None:
        self._kind = kind

    def __getattr__(self, name: str) -> Any:
        said = inspect.getattr_static(self._kind, name, None)
        if isinstance(said, property):
            return specimen(typing.get_type_hints(said.fget)["return"])
        if inspect.isfunction(said):
            return lambda *_: specimen(typing.get_type_hints(said)["return"])
        hints = typing.get_type_hints(self._kind)
        if name not in hints:
            raise AttributeError(f"{self._kind.__name__} has no {name}")
        return specimen(hints[name])

    def __getitem__(self, _: object) -> Any:
        return self.__getattr__("__getitem__")()

    def __iter__(self) -> collections.abc.Iterator[Any]:
        yield self[0]

    def __str__(self) -> str:
        return ""


def specimen(hint: Any) -> Any:
    """Return a value as a type hint says it: of several kinds the first that is not None."""
    kind, parts = typing.get_origin(hint), typing.get_args(hint)
    if kind in (types.UnionType, typing.Union):
        return specimen(next(part for part in parts if part is not type(None)))
    if kind is typing.ClassVar:
        return specimen(parts[0])
    if kind is typing.Literal:
        return parts[0]
    if kind is np.ndarray or hint is np.ndarray:
        return np.ones((2, 2))
    if kind is tuple:
        return tuple(specimen(part) for part in parts if part is not ...)
    if kind is not None and issubclass(kind, collections.abc.Mapping):
        return {"name": specimen(parts[1])}
    if kind is not None and issubclass(kind, collections.abc.Iterable):
        return [specimen(parts[0])]
    if hint in REAL:
        return REAL[hint]
    if hint in (str, int, float, bool):
        return hint(1)
    if hint in WHOLE:
        return hint(**{name: specimen(part) for name, part in typing.get_type_hints(hint).items()})
    if issubclass(hint, enum.Enum):
        return next(iter(hint), "")
    return Specimen(hint)


def _require_values(found: Any) -> None:
    """Raise unless all that was found is data: a path that ends at a method has no value."""
    assert not callable(found), found
    parts = found.values() if isinstance(found, dict) else found if isinstance(found, list | tuple) else ()
    for part in parts:
        _require_values(part)


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_is_of_one_class_and_finds_all_that_it_names(name: str) -> None:
    (kind,) = [one for one in _classes()[name] if f"{one.__module__}.{name}" not in ELSEWHERE]
    if name != "Estimate":  # it has several
        _require_values(take(Specimen(kind), SHAPES[name]))


@pytest.mark.parametrize("name", OF_ESTIMATES)
def test_the_shapes_of_an_estimate_find_all_that_they_name(name: str) -> None:
    shape, kind = OF_ESTIMATES[name]
    _require_values(take(Specimen(kind), shape))


def test_a_part_of_a_result_is_no_document() -> None:
    known = Identifiability((), (), (), 1.0, ())
    for part in (PositionHarmonics(1.0), known, Message(Kind.SUM, "a sum")):
        with pytest.raises(ji.MethodError):
            ji.to_dict(part)


@pytest.mark.parametrize(
    "shape",
    [
        "no_such",
        "data.no_such",
        "fit.measured.no_such",
        as_percentage("fit.no_such"),
        by_name("no_such"),
        {"a": {"b": "no"}},
    ],
)
def test_a_misspelt_path_is_found_out(shape: Shape) -> None:
    with pytest.raises(AttributeError):
        take(Specimen(Estimate), shape)
