"""A joint file checked as a whole, and what is wrong with it said at once.

A file with faults is checked as far as it goes: every table, channel and parameter that is right in itself still
takes part in the checks that need several of them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Self, TypeVar

from pydantic import ValidationError

from jointid.common.errors import JointFileError
from jointid.jointfile.fitting import method_faults, parameter_faults, record_faults, unit_faults
from jointid.jointfile.laws import LAWS
from jointid.jointfile.schema import (
    DIDIMS,
    ChannelsTable,
    ChannelTable,
    FileTable,
    JointTable,
    MethodTable,
    ParameterTable,
    RunTable,
)
from jointid.jointfile.table import Table, sentences
from jointid.model.controllers import Controller
from jointid.model.parameters import Kind

T = TypeVar("T", bound=Table)

_KINDS: tuple[Kind, ...] = ("prismatic", "revolute")


def checked(raw: Mapping[str, Any]) -> FileTable:
    """Return the tables of a joint file, given as `tomllib` reads them.

    Raises:
        JointFileError: with one sentence for each fault.
    """
    faults: list[str] = []
    try:
        file = FileTable.model_validate(raw)
    except ValidationError as error:
        faults += sentences(error)
    faults += _Draft.of(raw).faults()
    if faults:
        raise JointFileError(faults)
    return file


@dataclass(frozen=True, slots=True)
class _Draft:
    """What of a joint file is right in itself; what is not is None, or left out.

    Attributes:
        joint: what is identified.
        kinds: its kind; every kind, while that is not known.
        model: its model, while that is known.
        channels: the channels that are right.
        named: names of those and of the others.
        controller: the controller's law.
        controlled: whether the file has a controller, right or not.
        method: how to identify.
        parameters: the parameters that are right.
        bare: names of those that are given by a bare number.
        runs: the records that are identified together and are right, by their place.
    """

    joint: JointTable | None
    kinds: Collection[Kind]
    model: str | None
    channels: Mapping[str, ChannelTable]
    named: Collection[str]
    controller: Controller | None
    controlled: bool
    method: MethodTable | None
    parameters: Mapping[str, ParameterTable]
    bare: Collection[str]
    runs: Mapping[int, RunTable]

    @classmethod
    def of(cls, raw: Mapping[str, Any]) -> Self:
        kind, controller = _table(raw, "joint").get("kind"), raw.get("controller")
        channels, parameters = _table(raw, "record", "channels"), _table(raw, "parameters")
        law = next(filter(None, (_part(law, controller) for law in LAWS)), None)
        return cls(
            joint=_part(JointTable, raw.get("joint")),
            kinds=[known for known in _KINDS if known == kind] or _KINDS,
            model=_model(raw.get("joint")),
            channels={
                name: getattr(table, name)
                for name, value in channels.items()
                if (table := _part(ChannelsTable, {name: value}))
            },
            named=channels.keys(),
            controller=law.controller() if law else None,
            controlled=controller is not None,
            method=_part(MethodTable, raw.get("method", {})),
            parameters={
                name: parameter for name, value in parameters.items() if (parameter := _part(ParameterTable, value))
            },
            bare=[name for name, value in parameters.items() if not isinstance(value, dict)],
            runs={k: run for k, value in enumerate(_list(raw, "records")) if (run := _part(RunTable, value))},
        )

    def faults(self) -> Iterator[str]:
        """Yield what is wrong between the tables."""
        yield from unit_faults(self.channels, self.kinds)
        if self.method is not None:
            yield from method_faults(self.method, self.named, self.controller, self.controlled, self.model)
        if self.joint is not None:
            yield from parameter_faults(self.joint, self.parameters, self.bare)
        yield from record_faults(self.joint, self.controller, self.controlled, self.runs)


def _part(model: type[T], raw: object) -> T | None:
    """Return a table that is right in itself, None for one that is not."""
    try:
        return model.model_validate(raw)
    except ValidationError:
        return None


def _model(joint: object) -> str | None:
    """Return the model that [joint] names, right otherwise or not; None for a model that there is not."""
    named = joint.get("model", "rigid") if isinstance(joint, dict) else None
    return next((model for model in DIDIMS if model == named), None)


def _table(raw: Mapping[str, Any], *path: str) -> Mapping[str, Any]:
    """Return the raw table at a path, empty if there is none."""
    for key in path:
        below = raw.get(key)
        raw = below if isinstance(below, dict) else {}
    return raw


def _list(raw: Mapping[str, Any], key: str) -> list[Any]:
    """Return the raw list at a key, empty if there is none."""
    found = raw.get(key)
    return found if isinstance(found, list) else []
