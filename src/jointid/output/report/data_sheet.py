"""The data sheet of a joint: what a simulator asks of its actuator, each with its interval and a remark."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from jointid.common.document import Table
from jointid.common.parameters import POSITION_UNIT, TORQUE_UNIT, Quantity, unit_of
from jointid.common.text import in_words, number
from jointid.diagnostics.axis_parameters import Told, parameters_by_axis
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import show_value
from jointid.estimation.result.summary import remarks
from jointid.models.controllers.servo_base import Controller, require_one_each
from jointid.output.export.pd_law import controllers_of, pd_law

_CALLED = {
    "inertia": "armature and load",
    "motor_inertia": "armature",
    "rotor_inertia": "armature",
    "load_inertia": "inertia of the load",
    "viscous": "damping",
    "motor_viscous": "damping, motor side",
    "load_viscous": "damping, load side",
    "link_viscous": "damping, load side",
    "coulomb": "friction loss",
    "motor_coulomb": "friction loss, motor side",
    "load_coulomb": "friction loss, load side",
    "link_coulomb": "friction loss, load side",
    "stiffness": "stiffness",
    "damping": "damping of the spring",
    "gap": "backlash",
}
"""What simulators and makers call the parameters, in the order of the sheet."""
_SAID = {Told.ROUGHLY: "known roughly", Told.NOT: "not significant", Told.REFUSED: "refused", Told.FIXED: "kept fixed"}


def data_sheets(estimate: Estimate, controllers: Sequence[Controller | None] = ()) -> Iterator[Table]:
    """Yield the data sheet of a joint, or of each joint of a robot.

    Args:
        estimate: by any method.
        controllers: of each joint; those that it was identified under where there are none.

    Raises:
        MethodError: there are more or fewer controllers than joints.
    """
    robot = estimate.robot
    names = ("",) if robot is None else robot.model.names
    require_one_each(controllers, len(names))
    laws = controllers_of(estimate) or controllers or (None,) * len(names)
    said, known = remarks(estimate), {one.name: one for one in parameters_by_axis(estimate)}
    for place, (axis, controller) in enumerate(zip(names, laws, strict=True)):
        rows, prefix = list[tuple[str, str, str, str]](), f"{axis}." if axis else ""
        own = [
            p for p in estimate.params.rows if p.name.startswith(prefix) and (p.of_joint or p.name.endswith("delay"))
        ]
        order = [*_CALLED]
        plain = {p.name: p.name.removeprefix(prefix) for p in own}
        for p in sorted(own, key=lambda p: order.index(plain[p.name]) if plain[p.name] in order else len(order)):
            verdict = _SAID.get(known[p.name].known, "") if p.name in known else ""
            remark = ", ".join(filter(None, (verdict, said.get(p.name, ""))))
            rows.append((_CALLED.get(plain[p.name]) or in_words(plain[p.name]), show_value(p), p.unit, remark))
        kind = estimate.settings.joint.kind if robot is None else robot.model.links[place].kind
        if robot is not None and not any(row[0] == "armature" for row in rows):
            sums = dict(zip(robot.names, robot.formulas, strict=True))
            (remark, value), one = ("not identified", number(robot.model.joints[place].rotor_inertia)), f"Ia{place + 1}"
            if within := [name for name, formula in sums.items() if one in formula.split(" + ")]:
                remark, value = f"only in the sum {within[0]}", "-"
            rows.insert(0, ("armature", value, unit_of(Quantity.INERTIA, kind, TORQUE_UNIT[kind]), remark))
        force = TORQUE_UNIT[kind] if robot is not None else estimate.settings.joint.force_unit
        freed = {p.name.removeprefix(prefix) for p in estimate.params.rows if p.free and not p.of_joint}
        rows += _law_rows(controller, force, POSITION_UNIT[kind], freed)
        yield Table(("quantity", "value ± 2 sigma", "unit", "remark"), tuple(rows), axis, words=(0, 2, 3))


def _law_rows(
    controller: Controller | None, force: str, position: str, identified: set[str]
) -> Iterator[tuple[str, str, str, str]]:
    """Yield the rows of the controller's numbers."""
    law = pd_law(controller)
    if law is None:
        yield ("gains", "-", "", "no law of position and velocity is declared")
        return
    known = "identified" if identified & {"position_gain", "velocity_gain", "derivative_gain", "gain"} else "declared"
    yield ("kp", number(law.stiffness), f"{force}/{position}", known)
    yield ("kd", number(law.damping), f"{force} s/{position}", known)
    if law.limit < math.inf:
        yield ("limit", number(law.limit), force, "declared")
    if "delay" not in identified:
        yield ("delay", f"{1e3 * law.delay:.4g}", "ms", "declared")
    if law.command_delay:
        yield ("delay of commands", f"{1e3 * law.command_delay:.4g}", "ms", "declared")
