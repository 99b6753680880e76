"""A function of position, velocity and acceleration that returns the torque, in C and in Python.

It has the numbers of a joint or a robot in it and needs nothing but sine and cosine. Springs do not deflect: motor and
link move alike. A robot's torques are by the recursive equations of Newton and Euler [Luh, Walker and Paul 1980],
written out for its links::

    w_i = R' w_p + z q',   f_i = m a_i + dw_i x h + w_i x (w_i x h),   n_i = I dw_i + w_i x (I w_i) + h x a_i

where ``h = m c`` and I are about the origin of the link's frame, so that no link needs to be a body.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from jointid import __version__
from jointid.common.arrays import FloatArray
from jointid.models.friction import KNOTS, Directions
from jointid.models.robots.inertial import inertia_matrix
from jointid.models.robots.robot import Robot
from jointid.output.export.joint_model import (
    JointModel,
    effects_left_out,
    friction_left_out,
    identifier,
    one_line,
    remarks,
)
from jointid.output.export.pd_law import PDLaw

Term: TypeAlias = "float | str"
"""A number, or the name of a variable."""
Terms: TypeAlias = Sequence[Term]
Written: TypeAlias = tuple[str, tuple[str, ...]]


class Statements:
    """Assignments of sums of products, which C and Python write alike; what is 0 is not written."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []

    def assign(self, text: str) -> str:
        """Return the variable that has a value."""
        self.lines.append((f"x{len(self.lines)}", text))
        return self.lines[-1][0]

    def add(self, *products: Terms) -> Term:
        """Return a sum of products: a number where all are numbers."""
        constant, parts = 0.0, []
        for product in products:
            factor = float(np.prod([one for one in product if not isinstance(one, str)]))
            names = [one for one in product if isinstance(one, str)]
            if not names:
                constant += factor
            elif factor:
                parts.append("*".join([*([] if factor == 1.0 else [f"({factor!r})"]), *names]))
        if not parts:
            return constant
        text = " + ".join([*parts, *([f"({constant!r})"] if constant else [])])
        return text if text.isidentifier() else self.assign(text)

    def sum_of(self, *vectors: Terms) -> list[Term]:
        """Return the sum of vectors."""
        return [self.add(*((one,) for one in each)) for each in zip(*vectors, strict=True)]

    def cross(self, a: Terms, b: Terms) -> list[Term]:
        """Return a vector product."""
        return [self.add((a[i], b[j]), (-1.0, a[j], b[i])) for i, j in ((1, 2), (2, 0), (0, 1))]

    def by(self, matrix: Sequence[Terms], a: Terms) -> list[Term]:
        """Return a matrix times a vector."""
        return [self.add(*zip(row, a, strict=True)) for row in matrix]

    def friction(self, v: Term, directions: Directions, rise: float = 0.0, speed: float = 0.0) -> Term:
        """Return the friction at a velocity, by lines in each direction and a rise towards standstill."""
        forwards, backwards, up, down = directions
        over, under = self.assign(f"({v} > 0)"), self.assign(f"({v} < 0)")
        terms: list[Terms] = [(forwards, v, over), (backwards, v, under), (up, over), (-down, under)]
        if rise:
            ratio = self.add((1.0 / speed, v, over), (-1.0 / speed, v, under))
            share, slope = 1.0, 0.0
            for (at, height), (after, other) in zip(KNOTS, (*KNOTS[1:], (np.inf, KNOTS[-1][1])), strict=True):
                change = (other - height) / (after - at) - slope
                slope += change
                bend = self.assign(f"({ratio} > {at!r})*({ratio} - {at!r})")
                terms += [(rise * change, bend, over), (-rise * change, bend, under)]
            terms += [(rise * share, over), (-rise * share, under)]
        return self.add(*terms)


def torque_of_links(out: Statements, robot: Robot) -> list[Term]:
    """Add the torques of the links about their joints, (n,), to the statements."""
    n, still = len(robot), [0.0, 0.0, 0.0]
    turns, places, forces, moments = [], [], [], []
    rates: list[tuple[Terms, Terms, Terms]] = []
    for i, link in enumerate(robot.links):
        z, R, origin = link.axis, link.rotation, [*link.origin.tolist()]
        parent = link.parent
        w_p, dw_p, a_p = rates[parent] if parent >= 0 else (still, still, [*(-robot.gravity).tolist()])
        if link.kind == "revolute":
            cosine, sine = out.assign(f"cos(q{i})"), out.assign(f"sin(q{i})")
            around, skew = np.outer(z, z), np.cross(np.eye(3), z)
            parts = [(R @ one).tolist() for one in (around, np.eye(3) - around, skew)]
            turn = [
                [out.add((a,), (b, cosine), (c, sine)) for a, b, c in zip(*rows, strict=True)]
                for rows in zip(*parts, strict=True)
            ]
            place: list[Term] = [*origin]
        else:
            turn = [[*row] for row in R.tolist()]
            place = [out.add((o,), (x, f"q{i}")) for o, x in zip(origin, (R @ z).tolist(), strict=True)]
        back = [*zip(*turn, strict=True)]
        w, dw = out.by(back, w_p), out.by(back, dw_p)
        a = out.by(back, out.sum_of(a_p, out.cross(dw_p, place), out.cross(w_p, out.cross(w_p, place))))
        along = [*z.tolist()]
        speed, push = ([out.add((x, f"{of}{i}")) for x in along] for of in "va")
        if link.kind == "revolute":
            dw = out.sum_of(dw, out.cross(w, speed), push)
            w = out.sum_of(w, speed)
        else:
            coriolis = out.cross(w, speed)
            a = out.sum_of(a, coriolis, coriolis, push)
        rates.append((w, dw, a))
        m, h = float(link.inertial[0]), [*link.inertial[1:4].tolist()]
        inertia = inertia_matrix(link.inertial).tolist()
        mass_force = [out.add((m, one)) for one in a]
        forces.append(out.sum_of(mass_force, out.cross(dw, h), out.cross(w, out.cross(w, h))))
        moments.append(out.sum_of(out.by(inertia, dw), out.cross(w, out.by(inertia, w)), out.cross(h, a)))
        turns.append(turn)
        places.append(place)
    found: list[Term] = []
    for i in range(n - 1, -1, -1):
        link = robot.links[i]
        found.insert(
            0, out.add(*zip(link.axis.tolist(), moments[i] if link.kind == "revolute" else forces[i], strict=True))
        )
        if link.parent >= 0:
            force, moment = out.by(turns[i], forces[i]), out.by(turns[i], moments[i])
            forces[link.parent] = out.sum_of(forces[link.parent], force)
            moments[link.parent] = out.sum_of(moments[link.parent], moment, out.cross(places[i], force))
    return found


def c_function(model: JointModel | Robot, laws: Sequence[PDLaw | None] = ()) -> Written:
    """Return the torque of a motion as a function in C, and the losses."""
    del laws

    def write(name: str, sizes: Sequence[str], lines: Sequence[tuple[str, str]], torques: Sequence[str]) -> list[str]:
        scalar = len(torques) == 1 and not isinstance(model, Robot)
        takes = ", ".join(f"double {one}" if scalar else f"const double {one}[{len(torques)}]" for one in "qva")
        more = "" if scalar else f", double torque[{len(torques)}]"
        ends = [f"return {torques[0]};"] if scalar else [f"torque[{i}] = {one};" for i, one in enumerate(torques)]
        return [
            *(f"/* {line.replace('*/', '* /')} */" for line in sizes), "", "#include <math.h>", "",
            f"{'double' if scalar else 'void'} {name}_torque({takes}{more})", "{",
            *(f"    const double {to} = {text};" for to, text in lines), *(f"    {line}" for line in ends), "}",
        ]  # fmt: skip

    return _function(model, write)


def python_function(model: JointModel | Robot, laws: Sequence[PDLaw | None] = ()) -> Written:
    """Return the torque of a motion as a function in Python, and the losses."""
    del laws

    def write(name: str, sizes: Sequence[str], lines: Sequence[tuple[str, str]], torques: Sequence[str]) -> list[str]:
        found = ", ".join(torques)
        return [
            *(f"# {line}" for line in sizes), "from math import cos, sin", "", "", f"def {name}_torque(q, v, a):",
            *(f"    {to} = {text}" for to, text in lines),
            f"    return {f'[{found}]' if isinstance(model, Robot) else found}",
        ]  # fmt: skip

    return _function(model, write)


def _function(model: JointModel | Robot, write: Callable[..., list[str]]) -> Written:
    """Return the text of a function, and the losses."""
    out, lost = Statements(), list[str]()
    scalar = not isinstance(model, Robot)
    size = 1 if isinstance(model, JointModel) else len(model)
    out.lines = [(f"{of}{i}", of if scalar else f"{of}[{i}]") for of in "qva" for i in range(size)]
    if isinstance(model, JointModel):
        lost = [*friction_left_out(model), *effects_left_out(model)]
        if model.flexible:
            lost.append("the deflection of the spring: motor and load move alike")
        torques, about = [_torque_of_joint(out, model)], remarks(model, lost)
        about.append(f"q {model.position_unit}, v and a per s and s2, torque {model.torque_unit}")
    else:
        model.require_linear_friction("A torque function takes", "simulate the robot")
        if any(model.flexible):
            lost.append("the deflection of the springs: motors and links move alike")
        torques = _torques_of_robot(out, model)
        about = [f"{model.name}: the torques of its motors behind their gears, written by jointid {__version__}"]
        units = zip(
            model.names, map(model.position_unit, range(size)), map(model.torque_unit, range(size)), strict=True
        )
        about += [f"{i}: {name}, position {p}, torque {t}" for i, (name, p, t) in enumerate(units)]
        about += [f"Lost: {sentence}" for sentence in lost]
    texts = [one if isinstance(one, str) else repr(one) for one in torques]
    lines = write(identifier(model.name), [one_line(line) for line in about], out.lines, texts)
    return "\n".join([*lines, ""]), tuple(lost)


def _torque_of_joint(out: Statements, model: JointModel) -> Term:
    terms: list[Terms] = [(model.values["offset"],)]
    for mass in model.masses.values():
        terms += [(mass.inertia, "a0"), (out.friction("v0", mass.directions),)]
    if model.weight is not None:
        at = out.add((model.weight.angle, "q0"))
        terms += [(model.weight.constant,), (model.weight.rate, "q0")]
        terms += [(model.weight.cos, out.assign(f"cos({at})")), (model.weight.sin, out.assign(f"sin({at})"))]
    ripple, values = model.joint.ripple, model.values
    for i, p in enumerate(() if ripple is None else ripple.parameters):
        at = out.add(((i // 2 + 1) * (model.wave or 0.0), "q0"))
        terms.append((values[p.name], out.assign(f"{'sin' if i % 2 else 'cos'}({at})")))
    return out.add(*terms)


def _torques_of_robot(out: Statements, robot: Robot) -> list[Term]:
    """Return the torques of the motors: their own, and what acts on links as the coupling takes it to them."""
    n, coupling, links = len(robot), robot.coupling, torque_of_links(out, robot)
    for i, joint in enumerate(robot.joints):
        if joint.spring is not None:
            own = out.friction(f"v{i}", joint.law.directions(joint.values, "load_"))
            links[i] = out.add((links[i],), (own,))
    behind: FloatArray = np.asarray(np.linalg.inv(coupling).T, dtype=np.float64)
    found: list[Term] = []
    for i, joint in enumerate(robot.joints):
        speed, rise = (out.add(*((c, f"{of}{k}") for k, c in enumerate(coupling[i].tolist()))) for of in "va")
        motor = joint.motor if joint.spring is None else joint.values
        directions = joint.law.directions(motor, "" if joint.spring is None else "motor_")
        friction = out.friction(speed, directions, joint.motor.get("stribeck_force", 0.0), joint.stribeck_speed or 0.0)
        pulled = ((behind[i, k].item(), links[k]) for k in range(n))
        found.append(out.add(*pulled, (joint.rotor_inertia, rise), (friction,), (joint.offset,)))
    return found
