"""Names, numbers and remarks as another language can hold them, and the header of every export.

The header says the source of the numbers, their standard errors, and what is left out. Nothing in it depends on the day
or on the machine: the same answer gives the same bytes. Whoever named a record must not write another tool's program.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Sequence

from jointid import __version__
from jointid.common import text
from jointid.estimation.result.params import EstimatedParameter
from jointid.output.export.joint_model import JointModel

_LONGEST = 48  # of the 63 characters that MATLAB reads of a name: what is put before and behind it stays readable
_REMARK = 300  # characters of somebody's text that a remark keeps


def one_line(said: str) -> str:
    """Return a text as one line that can be printed: whatever breaks or steers a line becomes a space.

    Unicode has line ends beside ``\\n``, marks that turn the direction of reading, and halves of characters, which no
    file can hold; all are of its categories C and Z.
    """
    shown = "".join(" " if unicodedata.category(char)[0] in "CZ" else char for char in said)
    words = " ".join(shown.split())
    return words if len(words) <= _REMARK else f"{words[:_REMARK]}..."


def identifier(wanted: str, reserved: Collection[str] = ()) -> str:
    """Return a name made of a text: a letter, then letters, digits and _ of ASCII; "joint" where nothing is left.

    Args:
        wanted: of any kind.
        reserved: words of the language, in lower case, that are no names.
    """
    plain = unicodedata.normalize("NFKD", wanted).encode("ascii", "ignore").decode("ascii")
    name = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_")[:_LONGEST].strip("_") or "joint"
    if not name[0].isalpha() or name.lower() in reserved:
        name = f"joint_{name}"
    return name


def number(value: float) -> str:
    """Return a number with all its digits, as every one of the languages reads it."""
    return repr(float(value) + 0.0)  # of 0 there is no negative


def remarks(model: JointModel, lost: Sequence[str]) -> list[str]:
    """Return the lines of a comment: what it is, where it comes from, every parameter with its interval, what is lost.

    Each is one printable line, whatever the joint or the record is called.
    """
    origin, transmission = model.origin, model.joint.transmission
    lines = [
        f"{model.name}: a {model.kind} {model.joint.model} joint, written by jointid {__version__}",
        f"from {origin.schema}" + (f", method {origin.method}" if origin.method else ""),
    ]
    for record, fingerprint in zip(origin.records, origin.fingerprints, strict=True):
        lines.append(f"record {record}" + (f", torque SHA-256 {fingerprint}" if fingerprint else ""))
    if transmission is not None:
        ratio = f"{transmission.motor_per_load!r} motor position per load position, efficiency taken as 1"
        lines.append(f"transmission: {ratio}; all numbers here are of the {model.side} side")
    lines += [f"{' '.join(dict.fromkeys((p.symbol, p.name)))}: {interval(p)}" for p in model.parameters]
    lines += [f"Lost: {sentence}" for sentence in lost]
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


def uneven_viscous(model: JointModel) -> tuple[str, ...]:
    """Return the sentence on a viscous friction that two directions share although they have their own; or none."""
    if all(mass.evenly_viscous for mass in model.masses.values()):
        return ()
    return ("the difference between viscous friction forwards and backwards; the mean of both is written",)


def effects_left_out(model: JointModel) -> tuple[str, ...]:
    """Return the sentence on what was identified beside the joint itself; or none."""
    kinds = sorted(set(model.origin.left_out))
    return (f"what was identified beside the joint: {', '.join(kinds)}",) if kinds else ()
