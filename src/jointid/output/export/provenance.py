"""The header of every export: source of its numbers, their standard errors, and what is left out.

Nothing in it depends on the day or on the machine: the same answer gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence

from jointid import __version__
from jointid.common import text
from jointid.estimation.result.params import EstimatedParameter
from jointid.output.export.joint_model import JointModel, Origin
from jointid.output.export.naming import one_line


def remarks(model: JointModel, lost: Sequence[str]) -> list[str]:
    """Return the lines of a comment: what it is, where it comes from, every parameter with its interval, what is lost.

    Each is one printable line, whatever the joint or the record is called.
    """
    lines = [
        f"{model.name}: a {model.kind} {model.joint.model} joint, written by jointid {__version__}",
        *_origin(model.origin),
        *_side(model),
        *(f"{' '.join(dict.fromkeys((p.symbol, p.name)))}: {interval(p)}" for p in model.parameters),
        *(f"Lost: {sentence}" for sentence in lost),
    ]
    return [one_line(line) for line in lines]


def interval(p: EstimatedParameter) -> str:
    """Return a parameter's value, twice its standard deviation and its unit, in words where there is none."""
    if p.value is None:
        bound = "" if p.lower_bound is None else f", at least {text.number(p.lower_bound)} {p.unit}"
        return f"refused: the record does not tell it{bound}"
    if not p.free:
        return f"{text.number(p.value)} {p.unit} (kept fixed)"
    known = "no interval" if p.stderr is None else f"+- {text.number(2 * p.stderr, 2)}, 2 sigma"
    return f"{text.number(p.value)} {p.unit} ({known}{'' if p.identifiable else '; not told by the record'})"


def _origin(origin: Origin) -> list[str]:
    method = f", method {origin.method}" if origin.method else ""
    hashes = [f", torque SHA-256 {mark}" if mark else "" for mark in origin.fingerprints]
    records = [f"record {name}{mark}" for name, mark in zip(origin.records, hashes, strict=True)]
    return [f"from {origin.schema}{method}", *records]


def _side(model: JointModel) -> list[str]:
    """Return the line that says of which side the numbers are; none where there is only one."""
    transmission = model.joint.transmission
    if transmission is None:
        return []
    ratio = f"{transmission.motor_per_load!r} motor position per load position, efficiency taken as 1"
    return [f"transmission: {ratio}; all numbers here are of the {model.side} side"]


def friction_shift(model: JointModel) -> float:
    """Return the constant force on the motor: its offset, and what makes an even Coulomb friction an uneven one."""
    return model.offset + model.motor.shift


def uneven_viscous(model: JointModel) -> tuple[str, ...]:
    """Return the sentence on a viscous friction that two directions share although they have their own; or none."""
    masses = [mass for mass in (model.motor, model.load) if mass is not None]
    if all(mass.evenly_viscous for mass in masses):
        return ()
    return ("the difference between viscous friction forwards and backwards; the mean of both is written",)


def effects_left_out(model: JointModel) -> tuple[str, ...]:
    """Return the sentence on what was identified beside the joint itself; or none."""
    kinds = sorted(set(model.origin.left_out))
    return (f"what was identified beside the joint: {', '.join(kinds)}",) if kinds else ()
