"""A joint file whose faults are looked for: its tables that are right in themselves."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Self, TypeVar, get_args

from pydantic import ValidationError

from jointid.common.units import Kind
from jointid.config.schema import (
    LAW_TABLES,
    GravityTable,
    JointTable,
    LawTable,
    LimitsTable,
    MethodTable,
    ParameterTable,
    RippleTable,
    TransmissionTable,
)
from jointid.config.schema_record import ChannelsTable, ChannelTable, DriveTable, RunTable, TogetherTable
from jointid.config.table import Table, refusal
from jointid.estimation.methods.registry import MODELS
from jointid.models.controllers import Controller
from jointid.models.joints import Joint
from jointid.records.drives import Drive
from jointid.records.record import CHANNELS

T = TypeVar("T", bound=Table)

KINDS: tuple[Kind, ...] = get_args(Kind)


@dataclass(frozen=True, slots=True)
class Draft:
    """The tables of a joint file that are right in themselves; one that is not is None, or left out.

    Attributes:
        joint: what is identified.
        gravity: of its load.
        ripple: of the joint.
        refusals: the rest of the sentence on a gravity or a ripple that this joint cannot have, by the table's name.
        parts: the joint of this model with its gravity and ripple, whose parameters are known; None while one of them
            is not right.
        kinds: its kind; every kind, while that is not known.
        model: its model, while that is known.
        transmission: between motor and load.
        geared: whether there is one, right or not.
        channels: the channels that are right.
        named: names of those and of the others, and of those that the drive's profile may find.
        drive: whose traces the channels are, with the torque constant.
        drive_refusal: the rest of the sentence on a drive that contradicts the torque constant.
        law: the controller's table.
        controlled: whether the file has a controller, right or not.
        method: how to identify.
        parameters: the parameters that are right.
        bare: names of those that are given by a bare number.
        runs: the records that are identified together and are right, by their place.
        together: how they are.
        limits: of the axis.
    """

    joint: JointTable | None
    gravity: GravityTable | None
    ripple: RippleTable | None
    refusals: Mapping[str, str]
    parts: Joint | None
    kinds: Collection[Kind]
    model: str | None
    transmission: TransmissionTable | None
    geared: bool
    channels: Mapping[str, ChannelTable]
    named: Collection[str]
    drive: Drive | None
    drive_refusal: str | None
    law: LawTable | None
    controlled: bool
    method: MethodTable | None
    parameters: Mapping[str, ParameterTable]
    bare: Collection[str]
    runs: Mapping[int, RunTable]
    together: TogetherTable | None
    limits: LimitsTable | None

    @classmethod
    def of(cls, raw: Mapping[str, Any]) -> Self:
        """Return what is right of the tables of a joint file, as `tomllib` reads them."""
        kind, controller = table_at(raw, "joint").get("kind"), raw.get("controller")
        listed = records if isinstance(records := raw.get("records"), list) else []
        drives = _part(DriveTable, raw.get("drive", {}))
        joint, gravity = _part(JointTable, raw.get("joint")), _part(GravityTable, raw.get("gravity"))
        drive: Drive | None = drives.build() if drives else None
        contradicted = None
        if drive is not None and joint is not None:
            contradicted = refusal(partial(joint.drive, drive))
            drive = joint.drive(drive) if contradicted is None else None
        found = () if drive is None or drive.traces is None else drive.traces.channels
        channels, parameters = table_at(raw, "record", "channels"), table_at(raw, "parameters")
        law = next(filter(None, (_part(law, controller) for law in LAW_TABLES)), None)
        ripple = _part(RippleTable, raw.get("ripple"))
        refusals = {} if joint is None else _refusals(joint, gravity, ripple)
        given = {"gravity": gravity, "ripple": ripple}
        whole = not refusals and not any(part is None and name in raw for name, part in given.items())
        return cls(
            joint=joint,
            gravity=gravity,
            ripple=ripple,
            refusals=refusals,
            parts=joint.joint(None, gravity=gravity, ripple=ripple) if joint is not None and whole else None,
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
            named=CHANNELS if drive is None else tuple(dict.fromkeys([*channels, *found])),
            drive=drive,
            drive_refusal=contradicted,
            law=law,
            controlled=controller is not None,
            method=_part(MethodTable, raw.get("method", {})),
            parameters={
                name: parameter for name, value in parameters.items() if (parameter := _part(ParameterTable, value))
            },
            bare=[name for name, value in parameters.items() if not isinstance(value, dict)],
            runs={k: run for k, value in enumerate(listed) if (run := _part(RunTable, value))},
            together=_part(TogetherTable, raw.get("together", {})),
            limits=_part(LimitsTable, raw.get("limits", {})),
        )

    @property
    def controller(self) -> Controller | None:
        """The controller's law."""
        return self.law.controller() if self.law else None


def _refusals(joint: JointTable, gravity: GravityTable | None, ripple: RippleTable | None) -> dict[str, str]:
    """Return why a joint cannot have what is said of it beside [joint], by the table's name."""
    if refused := refusal(lambda: joint.joint(None, gravity=gravity)):
        return {"gravity": refused}
    refused = refusal(lambda: joint.joint(None, gravity=gravity, ripple=ripple))
    return {"ripple": refused} if refused else {}


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


def table_at(raw: Mapping[str, Any], *path: str) -> Mapping[str, Any]:
    """Return the raw table at a path, empty if there is none."""
    for key in path:
        below = raw.get(key)
        raw = below if isinstance(below, dict) else {}
    return raw
