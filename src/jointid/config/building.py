"""An axis, and a joint file, from what their tables say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from jointid.common.errors import JointFileError, JointidError
from jointid.common.transmission import Transmission
from jointid.common.units import unit
from jointid.config.axis_units import controller_gain, texts_with_units, unit_faults, with_constant
from jointid.config.declaration import (
    TIMES,
    FileTable,
    make_method,
)
from jointid.config.file import Axis, File
from jointid.config.rules import RULES, Declaration, change_parameter, choose_method
from jointid.estimation.methods.registry import method_of
from jointid.models.controllers import Controller

_UPRIGHT = 1e-3  # rad, that a base is off the upright and yet upright


def declare_joint(file: FileTable, raw: Mapping[str, Any]) -> Declaration:
    """Declare the axis of a joint file, with its drive and its transmission.

    Args:
        file: what its tables say.
        raw: the tables as `tomllib` reads them.

    Raises:
        JointFileError: drive or transmission are impossible.
    """
    axis = file.joints[0]
    assert axis.kind is not None
    return complete(Declaration(
        file=file, axis=axis, raw=raw, kind=axis.kind, columns=file.columns, drive=file.drive, gear=None,
        method=file.method,
    ))  # fmt: skip


def complete(said: Declaration) -> Declaration:
    """Return a declaration with the torque constant and the transmission of its axis."""
    stated, raw, constant = said.axis.transmission, said.raw.get("transmission", {}), said.axis.torque_constant
    gear: Transmission | None = None
    try:
        drive = with_constant(said.drive, constant, said.raw["joint"].get("torque_constant"))
    except JointidError as error:
        raise JointFileError(said.fault(("drive",), f": {error}")) from error
    if stated is not None:
        given = {key: value for key, value in stated.items() if key != "lead_unit"}
        if "lead_unit" in stated and isinstance(raw["lead"], str):
            raise JointFileError(
                said.fault(("transmission", "lead_unit"), " is there beside the lead's own: leave it out.")
            )
        if "lead" in given:
            given["lead"] *= unit(stated.get("lead_unit", "m")).factor
        try:
            gear = Transmission(load=said.kind, **given)
        except JointidError as error:
            raise JointFileError(said.fault(("transmission",), f": {error}")) from error
    return replace(said, drive=drive, gear=gear)


def axis_of(said: Declaration) -> Axis:
    """Build an axis from its declaration.

    Raises:
        JointFileError: with a sentence for each contradiction between the tables.
    """
    joint, own, law = said.joint(), said.axis, said.law
    faults = [*unit_faults(said), *(fault for rule in RULES for fault in rule(said))]
    if faults:
        raise JointFileError(faults)
    controller: Controller | None = None
    if law is not None:
        ratio = {} if said.gear is None else {"ratio": said.gear.torque(said.law_side)}  # type: ignore[arg-type]
        made: Any = law
        controller = replace(made, gain=controller_gain(said), **ratio)
    known = {parameter.name: parameter for parameter in joint.parameters}
    written = said.raw.get("controller", {})
    return Axis(
        name=own.name,
        joint=joint,
        columns=said.columns,
        controller=controller,
        drive=said.drive,
        source=said.file.source,
        parameters={name: change_parameter(known[name], stated) for name, stated in own.parameters.items()},
        limits=own.limits,
        needed=method_of(_method_name(said)).channels(joint.model, controller),
        said=frozenset([*written, *(TIMES[key][0] for key in written if key in TIMES)]),
        quantities=dict(texts_with_units(written)),
    )


def joint_file(said: Declaration, path: Path) -> File:
    """Return a joint file from what it says of its axis; see `axis_of`."""
    axis = axis_of(said)
    return File(
        axes=(axis,),
        method=make_method(_method_name(said), said.method),
        filtering=said.file.filtering,
        parameters=axis.parameters,
        name=axis.name,
        runs=said.file.records,
        together=said.file.together,
        path=path,
    )


def _method_name(said: Declaration) -> str:
    name = choose_method(said)
    assert name is not None
    return name


def robot_method(said: FileTable) -> str:
    """Return the name of the given method of a robot, or of the default one for its channels."""
    if name := said.method.get("name"):
        return str(name)
    channels = [said.columns, *(one.channels for one in said.joints)]
    logged = any("torque" in one for one in channels) or said.drive.profile is not None
    if all(one.controller is not None for one in said.joints) and not logged and said.source.torque != "logged":
        return "didim"  # of the motor positions
    # A joint without a controller leaves one method only.
    measured = any("motor_position" in one for one in channels) or any(one.controller is None for one in said.joints)
    return "didim" if not measured else "drive_side" if any(one.model == "flexible" for one in said.joints) else "idim"
