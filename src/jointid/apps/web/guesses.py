"""Guess channels, units and the kind of the joint from the names of columns.

First come the names that engineers write where no drive did, then those of the drives' profiles, then words: "Actual
torque", "Lagesollwert", "iq_act". A channel that two columns may be is left for the person to choose.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping

from jointid.apps.web.fields import SCREW, list_units
from jointid.common.units import POSITION_UNITS, TORQUE_UNITS, normalise_unit, unit, units_of
from jointid.records.columns import known_units
from jointid.records.drives import load_profile, place_of, profile_names
from jointid.records.record import CHANNELS

_PROFILE_FIRST = "generic"

_USUAL = {
    "time": ("t", "time", "timestamp", "time s", "t s", "time ms", "t ms", "zeit"),
    "torque": ("vir", "trq", "tq", "torque", "force", "tau", "i q", "iq", "current", "torque cmd", "cmd torque"),
    "reference": (
        "qg", "q ref", "qref", "ref", "x ref", "pos ref", "position reference", "pos cmd", "cmd pos", "command",
        "setpoint", "set point", "pos set", "reference", "q cmd", "q d", "qd", "target",
    ),
    "motor_position": (
        "qm", "q m", "q", "pos", "pos act", "act pos", "position", "enc", "encoder", "q motor", "motor position",
        "pos fbk", "phi m",
    ),
    "load_position": ("ql", "q l", "q load", "load position", "pos load", "load encoder", "phi l"),
    "injected": ("injected", "pulses", "excitation", "pulses n"),
}  # fmt: skip
"""What engineers call these signals where no drive named them: the EMPS record and its like."""

_TORQUE = (
    r"torque|trq|tq|tau|force|(?:dreh)?moment(?:en)?|kraft|current|curr|strom|iq|"
    r"[mi] (?:soll|set|ist|act)"
)
_POSITION = r"positions?|pos|angle|winkel|lage|weg|enc|encoder|phi|q|x|axis"
_COMMANDED = r"ref|reference|cmd|command|commanded|set|setpoint|soll|sollwert|demand|target|desired|des"
_ACTUAL = r"act|actual|ist|istwert|istw|meas|measured|fbk|fb|feedback|enc|encoder"
_LOAD = r"load|link|second|external|abtrieb|last"
_OTHERWISE = (
    r"limit|lim|max|min|error|err|lag|deviation|schleppfehler|velocity|vel|speed|drehzahl|geschwindigkeit|acceleration|acc|"
    r"feedforward|ff|friction|id|status|word|temperature|rated|offset"
)
"""Words of names: what a signal is, on which side of the controller, and that it is something else."""

_GERMAN = re.compile(r"((?:dreh)?moment(?:en)?|strom|lage|positions?|weg|winkel)(sollwert|istwert|soll|ist)")
_HUMP = re.compile(r"(?<=[a-z])(?=[A-Z])")
_WORD = re.compile(r"[a-z0-9]+")
_BRACKETS = re.compile(r"\s*[\[(][^\[\]()]*[\])]\s*$")
_LAST = re.compile(r".*[A-Za-z0-9][_ .]([A-Za-z%]+)$")
_NO_UNITS_BEHIND = frozenset({"m", "h", "V", "min"})  # q_m is the motor's, not metres

_TIME_UNITS = units_of("time")
_KINDS = ("prismatic", "revolute")


def guess_draft(columns: Collection[str]) -> dict[str, str]:
    """Return the entries of the form that follow from the names of columns."""
    roles = guess_roles(columns)
    draft = {}
    for role, column in roles.items():
        if role == "time":
            draft["record.time"] = column
            if said := find_unit(column, _TIME_UNITS):
                draft["record.time_unit"] = said
            continue
        draft[f"record.channels.{role}.column"] = column
        for variant in (*_KINDS, SCREW):
            if said := find_unit(column, list_units(role, variant)):
                draft[f"record.channels.{role}.unit@{variant}"] = said
    moves = guess_kind(roles)
    return draft if moves is None else draft | {"joint.kind": moves}


def find_unit(column: str, known: Iterable[str]) -> str | None:
    """Return the unit that a column's name ends with: "iq [A]", "torque_Nm"; None where it is none of those known."""
    known = tuple(known)
    every = {normalise_unit(name): name for name in reversed(known)} | {name: name for name in known}
    bracketed = re.search(r"[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$", column)
    if bracketed is not None:
        return every.get(bracketed[1]) or every.get(normalise_unit(bracketed[1]))
    behind = _LAST.match(column)
    if behind is None or behind[1] in _NO_UNITS_BEHIND:
        return None
    return every.get(behind[1])


def guess_kind(roles: Mapping[str, str]) -> str | None:
    """Return how the axis moves, as far as the units of its torque and positions agree on it."""
    found = set()
    for role in ("torque", "reference", "motor_position"):
        for kind in _KINDS:
            named = None if role not in roles else find_unit(roles[role], known_units(role, kind))
            dimensions = TORQUE_UNITS if role == "torque" else POSITION_UNITS
            if named is not None and unit(named).dimension == dimensions[kind][0]:
                found.add(kind)
    return found.pop() if len(found) == 1 else None


def guess_roles(columns: Iterable[str]) -> dict[str, str]:
    """Return the column of each channel, and of "time", as far as exactly one of them is called so."""
    names = list(columns)
    found: dict[str, str] = {}
    for role in ("time", *CHANNELS):
        free = [name for name in names if name not in found.values()]
        called = (_only(name for name in free if _normalise(name) == usual) for usual in _USUAL.get(role, ()))
        column = next(filter(None, called), None)
        if column is None and role != "time":
            column = _find_by_profile(role, free) or _find_by_words(role, free)
        if column is not None:
            found[role] = column
    return found


def _find_by_profile(channel: str, names: list[str]) -> str | None:
    rest = [name for name in profile_names() if name != _PROFILE_FIRST]
    for profile in map(load_profile, (_PROFILE_FIRST, *rest)):
        called = [
            name for name in names if profile.signals(channel, name, {}) or profile.signals(channel, name, place_of(1))
        ]
        if len(called) == 1:
            return called[0]
    return None


def _find_by_words(role: str, names: list[str]) -> str | None:
    """Return the only column with the words of a channel, or with the unit of a torque."""
    stated = {name: _normalise(name) for name in names}
    stated = {name: words for name, words in stated.items() if not _has(_OTHERWISE, words)}
    if role == "torque":
        torques = [name for name, words in stated.items() if _has(_TORQUE, words)]
        commanded = [name for name in torques if _has(_COMMANDED, stated[name])]
        known = {one for kind in _KINDS for one in units_of(TORQUE_UNITS[kind][0], "current")}
        measured = [name for name in stated if find_unit(name, known) is not None]
        return (
            _only(commanded) or _only(torques) or _only(measured) or _only(n for n, w in stated.items() if w == "istw")
        )
    positions = {name: words for name, words in stated.items() if _has(_POSITION, words) and not _has(_TORQUE, words)}
    loads = {name for name, words in positions.items() if _has(_LOAD, words)}
    if role == "load_position":
        return _only(loads)
    wanted = {"reference": _COMMANDED, "motor_position": _ACTUAL}.get(role)
    if wanted is None:
        return None
    return _only(name for name, words in positions.items() if _has(wanted, words) and name not in loads)


def _only(names: Iterable[str]) -> str | None:
    found = list(names)
    return found[0] if len(found) == 1 else None


def _has(words: str, text: str) -> bool:
    return re.search(rf"\b(?:{words})\b", text) is not None


def _normalise(name: str) -> str:
    """Return the words of a name, without a unit behind them."""
    text = _HUMP.sub(" ", _BRACKETS.sub("", name)).casefold()
    words = " ".join(_WORD.findall(text))
    return _GERMAN.sub(r"\1 \2", words)
