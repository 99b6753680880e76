"""What takes a controller's output to torque, found from the units of its numbers and from the torque constant.

The torque constant is said once, below [joint]; the torque's channel and the controller both take theirs from it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from jointid.common import units
from jointid.common.errors import JointFileError
from jointid.common.parameters import TORQUE_UNIT
from jointid.common.settings import settings_of
from jointid.common.units import Kind
from jointid.config.consistency import torque_unit
from jointid.config.draft import Draft
from jointid.config.quantities import Stated, misfit, output_of
from jointid.config.schema import JointTable, LawTable
from jointid.models.controllers import LAWS
from jointid.records.drives import Drive

AGREES = 1e-3
"""Of a gain: one that is written with four digits is the torque constant."""


def unit_faults(draft: Draft) -> Iterator[str]:
    """Yield numbers of the joint and of the controller in units of the other kind of motion, or of two outputs."""
    joint, law = draft.joint, draft.law
    if joint is None or len(draft.kinds) > 1 or (draft.geared and draft.transmission is None):
        return
    kind = _kind_of(draft, "motor")
    if isinstance(joint.torque_constant, Stated):
        declared = "N/A or N/V" if kind == "prismatic" else "N m/A or N m/V"
        if fault := misfit(joint.torque_constant.text, declared):
            yield f"joint.torque_constant{fault}"
            return
    yield from _channel_faults(draft, joint)
    if law is None:
        return
    faults = list(_misfits(law, _kind_of(draft, law.side)))
    yield from faults
    if not faults and draft.drive is not None:
        try:
            _gain(draft, joint, law, draft.drive)
        except JointFileError as error:
            yield from error.faults


def controller_gain(draft: Draft) -> float:
    """Return the gain of the controller of a draft without faults."""
    assert draft.joint is not None
    assert draft.law is not None
    return _gain(draft, draft.joint, draft.law, draft.drive or Drive())


def _misfits(law: LawTable, kind: Kind) -> Iterator[str]:
    """Yield numbers in units of the other kind of motion, and those of two outputs."""
    outputs: dict[str, str] = {}
    for name, number, declared in _numbers(law):
        if fault := misfit(number.text, declared, kind):
            yield f"controller.{name}{fault}"
        elif output := output_of(number.text, declared, kind):
            outputs.setdefault(output, f'{name} = "{number.text}"')
    if len(outputs) > 1:
        (one, first), (other, second), *_ = outputs.items()
        yield (
            f"controller has {first} and {second}: an output in {one} and one in {other}; expected one for all of "
            "them: take them to one unit."
        )


def _numbers(law: LawTable) -> Iterator[tuple[str, Stated, str]]:
    """Yield a law's numbers that have a unit: their key, themselves, and what their declaration says."""
    made: Any = LAWS[law.law]  # mypy does not take a type for something with a hash
    for one in settings_of(made):
        number = getattr(law, one.name, None)
        if isinstance(number, Stated):
            yield one.name, number, one.setting.unit


def _gain(draft: Draft, joint: JointTable, law: LawTable, drive: Drive) -> float:
    """Return what takes the controller's output to torque on its own side.

    Raises:
        JointFileError: it is not known, or is said twice and differs.
    """
    given: float | None = law.gain if "gain" in law.model_fields_set else None
    spoken = _spoken(law, _kind_of(draft, law.side))
    if spoken is None:
        constant = drive.torque_constant or drive.torque_per_volt
        known = None if constant is None else constant * _through(draft, law)
        speaks_torque = given == 1.0 or (given is not None and _is_share(draft, drive, given, _through(draft, law)))
    else:
        known, speaks_torque = _of_output(draft, joint, drive, *spoken, _through(draft, law), given), False
    if given is None:
        return 1.0 if known is None else known
    if known is None or speaks_torque or abs(given / known - 1) <= AGREES:
        return given
    raise JointFileError(
        f"controller.gain is {given:g}, but {_why(joint, spoken)} makes it {known:.6g}; expected the same, or gain = 1 "
        "and plain numbers of a controller that speaks N or N m: leave the wrong one out."
    )


def _why(joint: JointTable, spoken: tuple[str, str] | None) -> str:
    constant = joint.torque_constant
    if constant is not None and (spoken is None or spoken[0] in ("A", "V")):
        return f"joint.torque_constant = {constant.text if isinstance(constant, Stated) else format(constant, 'g')}"
    return "" if spoken is None else spoken[1]


def _spoken(law: LawTable, kind: Kind) -> tuple[str, str] | None:
    """Return what the controller gives out, as its first number with a unit says, and that key as it stands."""
    for name, number, declared in _numbers(law):
        if output := output_of(number.text, declared, kind):
            return output, f'controller.{name} = "{number.text}"'
    return None


def _of_output(
    draft: Draft, joint: JointTable, drive: Drive, output: str, said: str, through: float, given: float | None
) -> float | None:
    """Return what takes one unit of the output to torque; None where only the given gain can say it."""
    torque = torque_unit(draft, joint.kind)
    if output in TORQUE_UNIT.values():
        if torque in ("A", "V"):
            raise JointFileError(_unlike(said, "a torque", f"record.channels.torque is in {torque}", torque))
        return 1.0
    if output == "%":
        if torque in ("A", "V"):
            raise JointFileError(_unlike(said, "a share of the rated torque", f"the torque is in {torque}", torque))
        try:
            return _share(draft, drive) * through
        except units.UnitError as error:
            raise JointFileError(f"{said} is {error}.") from None
    constants = {"A": drive.torque_constant, "V": drive.torque_per_volt}
    if constant := constants.pop(output):
        return constant * through
    if any(constants.values()):
        raise JointFileError(
            f"{said} is an output in {output}, but joint.torque_constant is per {'V' if output == 'A' else 'A'}; "
            "expected both in one unit: correct one of them."
        )
    if torque == output:
        return through
    if given is None:
        other = "N or N m" if torque is None else torque
        raise JointFileError(_unlike(said, f"an output in {output}", f"the torque is in {other}", output))
    return None


def _share(draft: Draft, drive: Drive) -> float:
    """Return what takes 1 % of the rated torque to torque, on the motor's side."""
    return drive.resolve_unit(units.unit("%"), _kind_of(draft, "motor")).factor


def _is_share(draft: Draft, drive: Drive, gain: float, through: float) -> bool:
    """Return True for the gain of a controller that gives out a share of the rated torque."""
    try:
        return abs(gain / (_share(draft, drive) * through) - 1) <= AGREES
    except units.UnitError:
        return False


def _unlike(said: str, output: str, torque: str, per: str) -> str:
    return (
        f"{said} is {output}, but {torque}; expected what takes one to the other: add the torque constant below "
        f'[joint], as torque_constant = "0.72 N m/{per}".'
    )


def _kind_of(draft: Draft, side: str) -> Kind:
    """Return how a side moves: with a lead the motor turns."""
    lead = draft.transmission is not None and draft.transmission.lead is not None
    return "revolute" if lead and side == "motor" else next(iter(draft.kinds))


def _through(draft: Draft, law: LawTable) -> float:
    """Return what takes a torque of the motor to the controller's side."""
    if draft.transmission is None or law.side == "motor" or draft.joint is None:
        return 1.0
    return abs(draft.transmission.transmission(draft.joint.kind).motor_per_load)


def _channel_faults(draft: Draft, joint: JointTable) -> Iterator[str]:
    """Yield that the constant is not per the torque's unit, and a gain of its column that is another one."""
    torque, drive = draft.channels.get("torque"), draft.drive
    if torque is None or drive is None or joint.torque_constant is None:
        return
    said = torque_unit(draft, joint.kind)
    if said in ("A", "V") and said != joint.torque_per:
        yield (
            f"record.channels.torque is in {said}, but {_why(joint, None)} is per {joint.torque_per}; expected both in "
            f'one unit: write the constant of what is logged, as torque_constant = "0.72 N m/{said}".'
        )
    if torque.gain == 1.0:
        return
    constant = drive.torque_constant or drive.torque_per_volt or 1.0
    if torque.unit in TORQUE_UNIT.values() and abs(torque.gain / constant - 1) > AGREES:
        per = joint.torque_per
        yield (
            f"record.channels.torque.gain is {torque.gain:g} to {torque.unit}, but {_why(joint, None)}; expected the "
            f'same: leave gain out and give unit = "{per}", or correct the wrong one.'
        )
