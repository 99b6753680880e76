"""Gain from a controller's output to torque, from its units and the torque constant.

The torque constant is given once, below [joint], for the torque's channel and the controller.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from jointid.common import units
from jointid.common.errors import Fault, JointFileError
from jointid.common.parameters import TORQUE_UNIT
from jointid.common.settings import settings_of
from jointid.common.units import Kind
from jointid.config.consistency import torque_unit
from jointid.config.quantities import Stated, misfit, output_of
from jointid.config.schema import FileTable, JointTable, LawTable
from jointid.models.controllers import LAWS
from jointid.records.drives import Drive

AGREES = 1e-3
"""Of a gain: one that is written with four digits is the torque constant."""


def unit_faults(file: FileTable) -> Iterator[Fault]:
    """Yield numbers of joint and controller in units of another motion or output."""
    joint, law = file.joint, file.controller
    if file.is_wrong("joint") or file.is_wrong("transmission"):
        return
    kind = file.kind_of_side("motor", joint.kind)
    if isinstance(joint.torque_constant, Stated):
        declared = "N/A or N/V" if kind == "prismatic" else "N m/A or N m/V"
        if fault := misfit(joint.torque_constant.text, declared):
            yield file.fault(("joint", "torque_constant"), fault, "unit")
            return
    yield from _channel_faults(file, joint)
    if law is None:
        return
    faults = list(_misfits(file, law, file.kind_of_side(law.side, joint.kind)))
    yield from faults
    if not faults and (drive := file.drive_of_joint) is not None:
        try:
            _gain(file, joint, law, drive)
        except JointFileError as error:
            yield from error.faults


def controller_gain(file: FileTable) -> float:
    """Return the gain of the controller of a file without faults."""
    assert file.controller is not None
    return _gain(file, file.joint, file.controller, file.drive_of_joint or Drive())


def _misfits(file: FileTable, law: LawTable, kind: Kind) -> Iterator[Fault]:
    """Yield numbers in units of the other kind of motion, and those of two outputs."""
    outputs: dict[str, str] = {}
    for name, number, declared in _numbers(law):
        if fault := misfit(number.text, declared, kind):
            yield file.fault(("controller", name), fault, "unit")
        elif output := output_of(number.text, declared, kind):
            outputs.setdefault(output, f'{name} = "{number.text}"')
    if len(outputs) > 1:
        (one, first), (other, second), *_ = outputs.items()
        yield file.fault(
            ("controller",),
            f" has {first} and {second}: an output in {one} and one in {other}; expected one for all of them: take "
            "them to one unit.",
            "unit",
        )


def _numbers(law: LawTable) -> Iterator[tuple[str, Stated, str]]:
    """Yield a law's numbers that have a unit: their key, themselves, and what their declaration says."""
    made: Any = LAWS[law.law]  # mypy does not take a type for something with a hash
    for one in settings_of(made):
        number = getattr(law, one.name, None)
        if isinstance(number, Stated):
            yield one.name, number, one.setting.unit


def _gain(file: FileTable, joint: JointTable, law: LawTable, drive: Drive) -> float:
    """Return the gain from the controller's output to torque on its side.

    Raises:
        JointFileError: it is not known, or is given twice and differs.
    """
    given: float | None = law.gain if "gain" in law.given else None
    spoken = _find_output(law, file.kind_of_side(law.side, joint.kind))
    if spoken is None:
        constant = drive.torque_constant or drive.torque_per_volt
        known = None if constant is None else constant * _through(file, law)
        speaks_torque = given == 1.0 or (given is not None and _is_share(file, drive, given, _through(file, law)))
    else:
        known, speaks_torque = _of_output(file, joint, drive, spoken, _through(file, law), given), False
    if given is None:
        return 1.0 if known is None else known
    if known is None or speaks_torque or abs(given / known - 1) <= AGREES:
        return given
    raise JointFileError(
        file.fault(
            ("controller", "gain"),
            f" is {given:g}, but {_why(file, spoken)} makes it {known:.6g}; expected the same, or gain = 1 "
            "and plain numbers of a controller that speaks N or N m: leave the wrong one out.",
        )
    )


def _why(file: FileTable, spoken: _StatedOutput | None) -> str:
    constant = file.joint.torque_constant
    if constant is not None and (spoken is None or spoken.output in ("A", "V")):
        said = constant.text if isinstance(constant, Stated) else format(constant, "g")
        return f"joint.torque_constant = {said}"
    return "" if spoken is None else f'controller.{spoken.key} = "{spoken.text}"'


class _StatedOutput(NamedTuple):
    """Output unit of a controller, with the key and text of the number that states it."""

    output: str
    key: str
    text: str

    def fault(self, file: FileTable, rest: str) -> Fault:
        """Return a fault of that number."""
        return file.fault(("controller", self.key), f' = "{self.text}" is {rest}', "unit")


def _find_output(law: LawTable, kind: Kind) -> _StatedOutput | None:
    for name, number, declared in _numbers(law):
        if output := output_of(number.text, declared, kind):
            return _StatedOutput(output, name, number.text)
    return None


def _of_output(
    file: FileTable, joint: JointTable, drive: Drive, spoken: _StatedOutput, through: float, given: float | None
) -> float | None:
    """Return the torque per unit of the output; None where only the given gain defines it."""
    torque, output = torque_unit(file, joint.kind), spoken.output
    if output in TORQUE_UNIT.values():
        if torque in ("A", "V"):
            raise JointFileError(_unlike(file, spoken, "a torque", f"record.channels.torque is in {torque}", torque))
        return 1.0
    if output == "%":
        if torque in ("A", "V"):
            raise JointFileError(
                _unlike(file, spoken, "a share of the rated torque", f"the torque is in {torque}", torque)
            )
        try:
            return _share(file, drive) * through
        except units.UnitError as error:
            raise JointFileError(spoken.fault(file, f"{error}.")) from None
    constants = {"A": drive.torque_constant, "V": drive.torque_per_volt}
    if constant := constants.pop(output):
        return constant * through
    if any(constants.values()):
        raise JointFileError(
            spoken.fault(
                file,
                f"an output in {output}, but joint.torque_constant is per "
                f"{'V' if output == 'A' else 'A'}; expected both in one unit: correct one of them.",
            )
        )
    if torque == output:
        return through
    if given is None:
        other = "N or N m" if torque is None else torque
        raise JointFileError(_unlike(file, spoken, f"an output in {output}", f"the torque is in {other}", output))
    return None


def _share(file: FileTable, drive: Drive) -> float:
    """Return the torque of 1 % of the rated torque, on the motor's side."""
    return drive.resolve_unit(units.unit("%"), file.kind_of_side("motor", file.joint.kind)).factor


def _is_share(file: FileTable, drive: Drive, gain: float, through: float) -> bool:
    """Return True for the gain of a controller that gives out a share of the rated torque."""
    try:
        return abs(gain / (_share(file, drive) * through) - 1) <= AGREES
    except units.UnitError:
        return False


def _unlike(file: FileTable, spoken: _StatedOutput, output: str, torque: str, per: str) -> Fault:
    return spoken.fault(
        file,
        f"{output}, but {torque}; expected what takes one to the other: add the torque constant to "
        f'the joint, as torque_constant = "0.72 N m/{per}".',
    )


def _through(file: FileTable, law: LawTable) -> float:
    """Return the factor from motor torque to the controller's side."""
    if file.transmission is None or law.side == "motor":
        return 1.0
    return abs(file.transmission.transmission(file.joint.kind).motor_per_load)


def _channel_faults(file: FileTable, joint: JointTable) -> Iterator[Fault]:
    """Yield contradictions between the torque constant and the torque's channel."""
    torque, drive = file.channels.get("torque"), file.drive_of_joint
    if torque is None or drive is None or joint.torque_constant is None:
        return
    said = torque_unit(file, joint.kind)
    if said in ("A", "V") and said != joint.torque_per:
        yield file.fault(
            ("record", "channels", "torque"),
            f" is in {said}, but {_why(file, None)} is per {joint.torque_per}; expected both in "
            f'one unit: write the constant of what is logged, as torque_constant = "0.72 N m/{said}".',
            "unit",
        )
    if torque.gain == 1.0:
        return
    constant = drive.torque_constant or drive.torque_per_volt or 1.0
    if torque.unit in TORQUE_UNIT.values() and abs(torque.gain / constant - 1) > AGREES:
        per = joint.torque_per
        yield file.fault(
            ("record", "channels", "torque", "gain"),
            f" is {torque.gain:g} to {torque.unit}, but {_why(file, None)}; expected the "
            f'same: leave gain out and give unit = "{per}", or correct the wrong one.',
        )
