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
from jointid.config.consistency import (
    KINDS,
    channel_faults,
    choose_method,
    free_faults,
    list_channels,
    method_faults,
    parameter_faults,
    record_faults,
    transmission_faults,
)
from jointid.config.schema import (
    FileTable,
    GravityTable,
    JointTable,
    MethodTable,
    ParameterTable,
    TransmissionTable,
)
from jointid.config.schema_controller import LAW_TABLES, LawTable
from jointid.config.schema_record import ChannelsTable, ChannelTable, DriveTable, RunTable, TogetherTable
from jointid.config.table import Table, refusal, sentences
from jointid.estimation.methods.registry import MODELS
from jointid.models.controllers import Controller
from jointid.models.joints import Joint
from jointid.models.parameters import Kind
from jointid.records.drives.drive import Drive
from jointid.records.record import CHANNELS

T = TypeVar("T", bound=Table)

_MOST = 1000  # keys of a table, records of a file


def check_tables(raw: Mapping[str, Any]) -> FileTable:
    """Return the tables of a joint file, given as `tomllib` reads them.

    Raises:
        JointFileError: with one sentence for each fault.
    """
    faults = list(_crowded(raw))
    if faults:  # each of so many would be a sentence
        raise JointFileError(faults)
    try:
        file = FileTable.model_validate(raw)
    except ValidationError as error:
        faults += sentences(error)
    faults += Draft.of(raw).faults()
    if faults:
        raise JointFileError(faults)
    return file


def named_method(raw: Mapping[str, Any]) -> str | None:
    """Return the method that a joint file names, or that it has where it names none; None if that is not known."""
    draft = Draft.of(raw)
    return choose_method(_table(raw, "method").get("name"), draft.named, draft.controlled, draft.model or "rigid")


@dataclass(frozen=True, slots=True)
class Draft:
    """The tables of a joint file that are right in themselves; one that is not is None, or left out.

    Attributes:
        joint: what is identified.
        gravity: of its load.
        heavy: whether the file has gravity, right or not.
        kinds: its kind; every kind, while that is not known.
        model: its model, while that is known.
        transmission: between motor and load.
        geared: whether there is one, right or not.
        channels: the channels that are right.
        named: names of those and of the others, and of those that the drive's profile may find.
        drive: whose traces the channels are.
        law: the controller's table.
        controlled: whether the file has a controller, right or not.
        method: how to identify.
        parameters: the parameters that are right.
        bare: names of those that are given by a bare number.
        runs: the records that are identified together and are right, by their place.
        together: how they are.
    """

    joint: JointTable | None
    gravity: GravityTable | None
    heavy: bool
    kinds: Collection[Kind]
    model: str | None
    transmission: TransmissionTable | None
    geared: bool
    channels: Mapping[str, ChannelTable]
    named: Collection[str]
    drive: Drive | None
    law: LawTable | None
    controlled: bool
    method: MethodTable | None
    parameters: Mapping[str, ParameterTable]
    bare: Collection[str]
    runs: Mapping[int, RunTable]
    together: TogetherTable | None

    @classmethod
    def of(cls, raw: Mapping[str, Any]) -> Self:
        """Return what is right of the tables of a joint file, as `tomllib` reads them."""
        kind, controller = _table(raw, "joint").get("kind"), raw.get("controller")
        listed = records if isinstance(records := raw.get("records"), list) else []
        drives = _part(DriveTable, raw.get("drive", {}))
        drive = drives.build() if drives else None
        channels, parameters = _table(raw, "record", "channels"), _table(raw, "parameters")
        law = next(filter(None, (_part(law, controller) for law in LAW_TABLES)), None)
        return cls(
            joint=_part(JointTable, raw.get("joint")),
            gravity=_part(GravityTable, raw.get("gravity")),
            heavy="gravity" in raw,
            kinds=[known for known in KINDS if known == kind] or KINDS,
            model=_model(raw.get("joint")),
            transmission=_part(TransmissionTable, raw.get("transmission")),
            geared="transmission" in raw,
            channels={
                name: getattr(table, name)
                for name, value in channels.items()
                if (table := _part(ChannelsTable, {name: value}))
            },
            # Of a drive that is wrong nobody knows which channels its profile finds.
            named=list_channels(channels, drive) if drive is not None else CHANNELS,
            drive=drive,
            law=law,
            controlled=controller is not None,
            method=_part(MethodTable, raw.get("method", {})),
            parameters={
                name: parameter for name, value in parameters.items() if (parameter := _part(ParameterTable, value))
            },
            bare=[name for name, value in parameters.items() if not isinstance(value, dict)],
            runs={k: run for k, value in enumerate(listed) if (run := _part(RunTable, value))},
            together=_part(TogetherTable, raw.get("together", {})),
        )

    @property
    def controller(self) -> Controller | None:
        """The controller's law."""
        return self.law.controller() if self.law else None

    @property
    def parts(self) -> Joint | None:
        """The joint of this model with its gravity, whose parameters are known; None while one of them is not right."""
        if self.joint is None or (self.heavy and self.gravity is None) or self.gravity_refusal:
            return None
        return self.joint.joint(None, gravity=self.gravity)

    @property
    def gravity_refusal(self) -> str | None:
        """The rest of the sentence on a gravity that this joint cannot have."""
        joint = self.joint
        return None if joint is None else refusal(lambda: joint.joint(None, gravity=self.gravity))

    def faults(self) -> Iterator[str]:
        """Yield what is wrong between the tables."""
        yield from transmission_faults(self)
        yield from channel_faults(self)
        if self.method is not None:
            yield from method_faults(self, self.method)
            yield from free_faults("method.free", self.method.free, self.controller)
        if self.gravity_refusal:
            yield f"gravity{self.gravity_refusal}"
        yield from parameter_faults(self)
        yield from record_faults(self)
        if self.together is not None:
            yield from free_faults("together.free", self.together.free, self.controller)


def _crowded(raw: Mapping[str, Any], where: str = "The joint file") -> Iterator[str]:
    """Yield the tables that have more keys, and the lists that have more tables, than anyone writes."""
    if len(raw) > _MOST:
        yield f"{where} has {len(raw)} keys; expected at most {_MOST}: is it another kind of file?"
        return
    for key, value in raw.items():
        if isinstance(value, dict):
            yield from _crowded(value, key)
        elif isinstance(value, list) and len(value) > _MOST and isinstance(value[0], dict):
            yield f"{key} lists {len(value)} tables; expected at most {_MOST}: split the joint file."


def _part(model: type[T], raw: object) -> T | None:
    """Return a table that is right in itself, None for one that is not."""
    try:
        return model.model_validate(raw)
    except ValidationError:
        return None


def _model(joint: object) -> str | None:
    """Return the model that [joint] names, right otherwise or not; None for a model that there is not."""
    named = joint.get("model", "rigid") if isinstance(joint, dict) else None
    return next((model for model in MODELS if model == named), None)


def _table(raw: Mapping[str, Any], *path: str) -> Mapping[str, Any]:
    """Return the raw table at a path, empty if there is none."""
    for key in path:
        below = raw.get(key)
        raw = below if isinstance(below, dict) else {}
    return raw
