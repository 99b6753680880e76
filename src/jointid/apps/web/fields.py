"""Fields of the page's form: the key of the joint file that each one sets, and how its text is read.

The type, the words and the unit of a field come from the declaration of its key. `form.toml` has its label and
explains its words. Keys without a field stay in further lines of the joint file ("extra").
"""

from __future__ import annotations

import contextlib
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any, Literal, TypeAlias

from jointid.common.settings import Declared
from jointid.common.units import units_of
from jointid.config.schema import FileTable
from jointid.config.table import list_keys
from jointid.models.friction import FRICTIONS
from jointid.models.springs import SPRINGS
from jointid.records.columns import known_units, unit_in_name
from jointid.records.record import CHANNELS

Form: TypeAlias = Literal["number", "numbers", "text", "choice", "column", "unit", "sign", "flag"]
Draft: TypeAlias = Mapping[str, str]

_ANY_LAW, _ANYTHING = "any law", "*"  # in a condition of `form.toml`

SCREW = "screw"
_LEAD = "transmission.lead"
_UNITS: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "prismatic": {"joint.kind": ("prismatic",), _LEAD: ("",)},
    "revolute": {"joint.kind": ("revolute",)},
    SCREW: {"joint.kind": ("prismatic",), _LEAD: (_ANYTHING,)},
}
"""By the variants of a channel's unit, when each applies."""

EXTRA = "extra"
"""The field of further lines of the joint file."""

LEARN, WITHOUT, EXTRA_LAW = "learn", "none", "extra"
"""Answers to the question for the controller's law that are no laws."""

_DIGITS = r"[+-]?([0-9]+[.,]?[0-9]*|[.,][0-9]+)([eE][+-]?[0-9]+)?"
_NUMBER = re.compile(_DIGITS)
_WITH_UNIT = re.compile(rf"({_DIGITS})\s*([^\s0-9.,;_][^;]*)")
_UNIT = re.compile(r"\[([^\[\]]*)\]$")  # at the end of a description
_VALUES: dict[str, dict[str, Any]] = {"sign": {"1": 1, "-1": -1}, "flag": {"true": True, "false": False}}
_BETWEEN = re.compile(r"\s*;\s*|\s*,\s+|\s+")  # numbers of a list, each of which may have a decimal comma


@dataclass(frozen=True, slots=True)
class Field:
    """One field.

    Attributes:
        key: its path in the joint file, and its name.
        label: what it is called.
        help: what it means, in a sentence.
        form: how it is entered.
        unit: behind the field, for a prismatic and for a revolute joint.
        choices: the joint file's words, and what they mean; "" leaves the key out.
        when: fields and the values one of which they must have for this one to count.
        usual: what a new form has.
        whole: whether a number is a whole one.
        variant: tells fields of one key apart, of which one counts at a time.
    """

    key: str
    label: str
    help: str = ""
    form: Form = "number"
    unit: tuple[str, str] = ("", "")
    choices: tuple[tuple[str, str], ...] = ()
    when: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    usual: str = ""
    whole: bool = False
    variant: str = ""

    @property
    def name(self) -> str:
        """Its name in the form."""
        return f"{self.key}@{self.variant}" if self.variant else self.key

    def applies(self, draft: Draft) -> bool:
        """Return whether the field applies, given the other fields."""
        given = ((draft.get(name, usual(name)), values) for name, values in self.when.items())
        return all(text in values or (_ANYTHING in values and bool(text)) for text, values in given)

    def read(self, draft: Draft) -> Any:
        """Return its value as the joint file has it, None where it is empty.

        A text that is none of its values is left as it is, for the schema to refuse.
        """
        text = draft.get(self.name, self.usual).strip()
        words = _VALUES.get(self.form, {})
        with contextlib.suppress(ValueError):
            if text and self.form == "numbers":
                return _decimals(text)
            if text and self.form == "number":
                if not _NUMBER.fullmatch(text) and (found := _WITH_UNIT.fullmatch(text)):
                    return f"{found[1].replace(',', '.')} {found[4]}"
                value = _decimal(text)
                return int(value) if self.whole and value.is_integer() else value
        return words.get(text, text or None)

    def number_fault(self, draft: Draft) -> str | None:
        """Return the fault of a text in a field of numbers; None without a fault."""
        text = self.read(draft)
        if self.form not in ("number", "numbers") or not isinstance(text, str) or _WITH_UNIT.fullmatch(text):
            return None
        if self.form == "numbers" and re.fullmatch(r"[0-9]+,[0-9]+", text):
            point, two = text.replace(",", "."), text.replace(",", "; ")
            return f'{self.label} is "{text}", which is one number or two; write {point} or {two}.'
        return f'{self.label} is "{text}"; expected a number in plain digits, such as 12.5 or 1e-3: correct it.'

    def write(self, value: Any) -> str | None:
        """Return a value of a joint file as the field shows it; None where it cannot."""
        text = None
        match self.form:
            case "number" if isinstance(value, int | float) and not isinstance(value, bool):
                text = repr(value)
            case "number" if isinstance(value, str):  # with a unit, as the joint file may have it
                text = value
            case "numbers" if isinstance(value, list) and all(isinstance(item, int | float) for item in value):
                text = ", ".join(map(repr, value))
            case "flag" if isinstance(value, bool):
                text = str(value).lower()
            case "sign" if value in (1, -1):
                text = str(value)
            case "choice" | "unit" if isinstance(value, str) and value in dict(self.choices):
                text = value
            case "text" | "column" if isinstance(value, str):
                text = value
        return text


def _decimal(text: str) -> float:
    """Return a plain decimal number, with a point or a comma.

    Python reads more as one, such as 1_0 and the digits of other scripts.

    Raises:
        ValueError: it is none.
    """
    if not _NUMBER.fullmatch(text.strip()):
        raise ValueError
    return float(text.replace(",", "."))


def _decimals(text: str) -> list[float]:
    """Parse a list of numbers, such as "0.5, 0.5", "0,5; 0,5" or "[0.5,0.5]".

    Raises:
        ValueError: one is no number, or a comma is ambiguous.
    """
    text = text.strip("[] \t")
    if "." in text and "," in text:
        return [_decimal(part) for part in text.split(",")]
    if re.fullmatch(r"[0-9]+,[0-9]+", text):
        raise ValueError
    return [_decimal(part) for part in _BETWEEN.split(text)]


def _define_entry(name: str, said: Mapping[str, Any], key: str = "") -> Field:
    """Return the field of a key; `said` is its entry in `form.toml`, which goes before the declaration."""
    path, _, variant = name.partition("@")
    known = _KEYS.get(key or path)
    meant = _LABELS.get(path, said.get("words", {}))
    others = {word: word for word in _choices(known) if word not in meant}
    unit = None if known is None else _UNIT.search(known.setting.description)
    # A declaration has the units of a prismatic and a revolute joint as "controller units per m/s or rad/s".
    straight, _, turning = (unit[1] if unit else "").partition(" or ")
    before, per, _ = straight.rpartition(" per ")
    units = straight, f"{before}{per}{turning}" if turning else straight
    return Field(
        key or path,
        said["label"],
        said.get("help", ""),
        said.get("form") or _find_form(known),
        tuple(said["unit"]) if "unit" in said else units,
        tuple({**meant, **others}.items()),
        {other: _expand_laws(values) for other, values in said.get("when", {}).items()},
        said.get("usual", ""),
        said.get("whole", known is not None and known.type is int),
        variant,
    )


def _expand_laws(values: Sequence[str]) -> tuple[str, ...]:
    """Return the values of a condition, with each law in the place of the word for any."""
    return tuple(each for value in values for each in (LAWS if value == _ANY_LAW else (value,)))


def _choices(known: Declared | None) -> tuple[str, ...]:
    return () if known is None else known.choices or tuple(map(str, known.setting.only))


def _find_form(known: Declared | None) -> Form:
    if known is not None and _choices(known):
        return "sign" if known.type is int else "choice"
    forms: dict[Any, Form] = {bool: "flag", str: "text", tuple[float, ...]: "numbers", tuple[int, int]: "numbers"}
    return "number" if known is None else forms.get(known.type, "number")


def _define_group(group: str) -> tuple[Field, ...]:
    return tuple(_define_entry(name, said) for name, said in _FORM[group].items())


def list_units(channel: str, variant: str) -> tuple[str, ...]:
    """Return the units of a channel: of a motion, or of both sides of a screw, whose motor turns."""
    kinds = ("prismatic", "revolute") if variant == SCREW else (variant,)
    return tuple(dict.fromkeys(unit for kind in kinds for unit in known_units(channel, kind)))


def _define_channel(channel: str) -> tuple[Field, ...]:
    """Return the fields of a channel: its column, its units, and the rest."""
    path = f"record.channels.{channel}"
    units = tuple(
        Field(f"{path}.unit", "Unit", "", "unit", when=when, variant=variant,
              choices=(("", "choose ..."), *((u, u) for u in list_units(channel, variant))))
        for variant, when in _UNITS.items()
    )  # fmt: skip
    rest = tuple(
        _define_entry(key, said, f"{path}.{key}")
        for key, said in _FORM["of_channel"].items()
        if channel in said.get("of", CHANNELS) and f"{path}.{key}" in _KEYS
    )
    return (_define_entry("column", {**_FORM["channel"][channel], "form": "column"}, f"{path}.column"), *units, *rest)


_OWN_WORDS = ("controller.law", "controller.velocity_filter.kind")  # some of their choices have no fields
_KEYS = {  # of several laws that of the first
    key.place: key.declared for key in reversed(list(list_keys(FileTable))) if key.place not in _OWN_WORDS
}
_FORM: dict[str, dict[str, dict[str, Any]]] = tomllib.loads(
    files("jointid.apps.web").joinpath("form.toml").read_text(encoding="utf-8")
)
LAWS = tuple(word for word in _FORM["law"]["controller.law"]["words"] if word not in ("", LEARN, WITHOUT, EXTRA_LAW))
"""The laws that have fields."""

_LABELS = {
    "joint.friction": {law.name: law.label for law in FRICTIONS.values()},
    "joint.spring": {name: law.label for name, law in SPRINGS.items()},
}
(KIND,), CLOCK, TEXT, GEAR, DRIVE = map(_define_group, ("kind", "clock", "text", "gear", "drive"))
JOINT, (LAW,), CONTROLLER, METHOD = map(_define_group, ("joint", "law", "controller", "method"))
CHANNEL_FIELDS = {channel: _define_channel(channel) for channel in CHANNELS}

CHANNEL_STEP: tuple[Field, ...] = (
    KIND, *CLOCK, *TEXT, *GEAR, *(one for fields in CHANNEL_FIELDS.values() for one in fields), *DRIVE,
)  # fmt: skip
JOINT_STEP: tuple[Field, ...] = (*JOINT, LAW, *CONTROLLER, *METHOD)
FIELDS: tuple[Field, ...] = (*CHANNEL_STEP, *JOINT_STEP)
NAMES = frozenset({EXTRA, *(one.name for one in FIELDS)})
"""The names that a draft may hold."""

_USUAL = {one.name: one.usual for one in FIELDS if one.usual}


def usual(name: str) -> str:
    """Return the initial text of a field."""
    return _USUAL.get(name, "")


def time_unit(column: str) -> str:
    """Return the unit of a time column as its name has it, or s."""
    return unit_in_name(column, units_of("time")) or "s"
