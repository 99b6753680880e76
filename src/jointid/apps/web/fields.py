"""The fields of the page's form: which key of the joint file each one is, and what it is called in plain words.

A field's name begins with the path of its key. How it is entered, its unit and the words it chooses among are those of
the setting's declaration, and so is its help where none is written here; what it is called, and what a word means to
someone who never read a joint file, is said here. What has no field can be said in the lines of the joint file that the
form keeps as they are, "extra".
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from jointid import PD, PID, Cascade, Column, Drive, Filtering, FlexibleDIDIM, Gravity, Transmission
from jointid.common.settings import Declared, settings_of
from jointid.common.units import units_of
from jointid.config.schema_record import Source
from jointid.models.friction import FRICTIONS
from jointid.records.columns import known_units, unit_in_name
from jointid.records.record import CHANNELS

Form: TypeAlias = Literal["number", "numbers", "text", "choice", "column", "unit", "sign", "flag"]
Draft: TypeAlias = Mapping[str, str]

EXTRA = "extra"
"""The field of further lines of the joint file."""

LAWS = ("cascade", "pd", "pid")
"""The laws that have fields."""

LEARN, WITHOUT, EXTRA_LAW = "learn", "none", "extra"
"""Answers to the question for the controller's law that are no laws."""

_EXPONENT = r"([eE][+-]?[0-9]+)?"
_NUMBER = re.compile(rf"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+){_EXPONENT}")
_COMMA = re.compile(rf"(?<![0-9,])[+-]?[0-9]+,[0-9]+{_EXPONENT}(?![0-9,])")  # one that may be a decimal mark


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
    variant: str = ""

    @property
    def name(self) -> str:
        """Its name in the form."""
        return f"{self.key}@{self.variant}" if self.variant else self.key

    def applies(self, draft: Draft) -> bool:
        """Whether it counts, beside what stands in the other fields."""
        return all(draft.get(name, usual(name)) in values for name, values in self.when.items())

    def read(self, draft: Draft) -> Any:
        """Return its value as the joint file has it, None where it is empty.

        A text that is none of its values is left as it is, for the schema to refuse.
        """
        text = draft.get(self.name, self.usual).strip()
        try:
            match self.form:
                case _ if not text:
                    return None
                case "number":
                    return _decimal(text)
                case "numbers":
                    return [_decimal(part) for part in text.strip("[]").split(";" if ";" in text else ",")]
                case "sign":
                    return {"1": 1, "-1": -1}.get(text, text)
                case "flag":
                    return {"true": True, "false": False}.get(text, text)
        except ValueError:
            pass
        return text

    def number_fault(self, draft: Draft) -> str | None:
        """Return what is said of a text where numbers belong, None where there is nothing to say."""
        text = self.read(draft)
        if self.form not in ("number", "numbers") or not isinstance(text, str):
            return None
        if comma := _COMMA.search(text):
            plain = comma[0].replace(",", ".")
            return f'{self.label} is "{text}"; expected a number with a decimal point: write {plain}.'
        return f'{self.label} is "{text}"; expected a number in plain digits, such as 12.5 or 1e-3: correct it.'

    def write(self, value: Any) -> str | None:
        """Return a value of a joint file as the field shows it; None where it cannot."""
        text = None
        match self.form:
            case "number" if isinstance(value, int | float) and not isinstance(value, bool):
                text = repr(value)
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
    """Return a plain decimal number; Python reads more as one, such as 1_0 and the digits of other scripts.

    Raises:
        ValueError: it is none.
    """
    if not _NUMBER.fullmatch(text.strip()):
        raise ValueError
    return float(text)


def _of(
    owner: type,
    key: str,
    label: str,
    help: str | None = None,  # noqa: A002
    words: Mapping[str, str] | None = None,
    **further: Any,
) -> Field:
    """Return the field of a setting.

    Args:
        owner: the dataclass that declares it.
        key: its path in the joint file.
        label: what it is called.
        help: what it means; as it is declared when None.
        words: what each of the words means that the setting chooses among; "" leaves the key out.
        further: the other attributes of the field.

    Raises:
        KeyError: a word is not told.
    """
    one = next(one for one in settings_of(owner) if one.name == key.rpartition(".")[2])
    words = words or {}
    choices = tuple((word, words[word]) for word in (*([""] if "" in words else []), *_words(one)))
    meaning = one.setting.help.partition(";")[0]
    said = f"{meaning[:1].upper()}{meaning[1:]}." if help is None else help
    return Field(
        key, label, said, **{"form": _form(one), "unit": _units(one.setting.unit), "choices": choices} | further
    )


def _words(one: Declared) -> tuple[str, ...]:
    """Return the words among which a setting chooses, as a form sends them."""
    if one.type is bool:
        return "true", "false"
    return tuple(map(str, one.setting.only)) or one.choices


def _form(one: Declared) -> Form:
    """Return how a setting is entered."""
    if one.choices:
        return "choice"
    if one.setting.only:
        return "sign"
    return {bool: "flag", str: "text", float: "number", int: "number"}.get(one.type, "numbers")  # type: ignore[return-value]


def _units(unit: str) -> tuple[str, str]:
    """Return a declared unit for a prismatic and for a revolute joint: "controller units per m/s or rad/s"."""
    straight, _, turning = unit.partition(" or ")
    before, per, _ = straight.rpartition(" per ")
    return straight, f"{before}{per}{turning}" if turning else straight


_LAWED = {"controller.law": LAWS}

KIND = Field(
    "joint.kind", "How it moves", "Decides the units: m and N, or rad and N m.", "choice",
    choices=(("prismatic", "moves straight (a linear axis)"), ("revolute", "turns (a rotary axis, a robot's joint)")),
    usual="prismatic",
)  # fmt: skip

CHANNEL_WORDS = {
    "torque": ("Motor torque or force", "What the controller asks of the motor: a torque, a force, a current."),
    "reference": ("Commanded position", "Where the axis was told to be at each instant: the reference."),
    "motor_position": (
        "Motor position",
        "The motor's encoder. Not needed if you know the controller; it lets the page learn the controller.",
    ),
    "load_position": ("Load position", "A second encoder behind the gear or the spring, if there is one."),
    "reference_velocity": ("Commanded velocity", "Only if the controller reads one beside the commanded position."),
    "injected": ("Added test signal", "A known signal that was added to the controller's output, such as pulses."),
}
"""What each channel is called, and what it is."""

CLOCK = (
    _of(Source, "record.time", "Time", "The column with the time of each row.", form="column"),
    _of(Source, "record.time_unit", "Unit of the time", "Left open: as the column's name says, or seconds.",
        {"": "as named, or s", **{unit: unit for unit in units_of("time")}}),
    _of(Source, "record.sample_time", "Time between rows", "Needed where there is no time column."),
)  # fmt: skip

TEXT = (
    Field("record.delimiter", "Between the cells", "Of a text file: such as ; or ,  - found by itself if left empty.",
          "text"),
    Field("record.decimal", "Decimal mark", "Of a text file.", "choice",
          choices=(("", "found by itself"), (".", "point: 1.5"), (",", "comma: 1,5"))),
    Field("record.header", "First line", "Of a text file.", "flag",
          choices=(("", "found by itself"), ("true", "names the columns"), ("false", "is numbers already"))),
)  # fmt: skip


def channel_fields(channel: str) -> tuple[Field, ...]:
    """Return the fields of one channel of the record."""
    path = f"record.channels.{channel}"
    units = tuple(
        Field(f"{path}.unit", "Unit", "", "unit", when={"joint.kind": (kind,)}, variant=kind,
              choices=(("", "as named, or SI"), *((u, u) for u in known_units(channel, kind))))
        for kind in ("prismatic", "revolute")
    )  # fmt: skip
    made = [
        _of(Column, f"{path}.column", *CHANNEL_WORDS[channel], form="column"),
        *units,
        _of(Column, f"{path}.gain", "Multiply by"),
        _of(Column, f"{path}.sign", "Direction", "", {"1": "as it is", "-1": "turned round"}),
        _of(Column, f"{path}.timing", "A value stands for", "",
            {"": "the usual", "sampled": "its instant", "held": "the time until the next value",
             "averaged": "the mean since the last value"}),
    ]  # fmt: skip
    if channel == "torque":
        made.append(
            _of(Column, f"{path}.tap", "Where it was logged", "",
                {"": "the controller's output", "command": "the controller's output",
                 "filtered": "behind the drive's torque filters", "measured": "a measured current"})
        )  # fmt: skip
    if channel == "injected":
        made += [
            _of(Column, f"{path}.at", "It is added", "",
                {"": "after the torque limit", "after_limit": "after the torque limit",
                 "before_limit": "before the torque limit"}),
            _of(Column, f"{path}.in_torque", "The logged torque", "",
                {"": "contains it", "true": "contains it", "false": "does not contain it"}),
        ]  # fmt: skip
    elif channel.endswith("position") or channel == "reference":
        made.append(_of(Column, f"{path}.wrap", "Begins again at", "Of an encoder that wraps round: 65536, or 360."))
    return tuple(made)


CHANNEL_FIELDS = {channel: channel_fields(channel) for channel in CHANNELS}

DRIVE = (
    _of(Drive, "drive.torque_constant", "Torque constant", "Takes a current to a torque."),
    _of(Drive, "drive.rated_torque", "Rated torque", "What % and per mille are a share of."),
    _of(Drive, "drive.counts_per_turn", "Encoder counts in one turn", "", when={"joint.kind": ("revolute",)}),
    _of(Drive, "drive.counts_per_metre", "Encoder counts in one metre", "", when={"joint.kind": ("prismatic",)}),
)

JOINT = (
    Field("joint.model", "What is looked for", "Flexible needs a motion that excites the spring.", "choice",
          choices=(("rigid", "one mass and its friction (rigid)"),
                   ("flexible", "two masses and the spring between them (flexible)")), usual="rigid"),
    Field("joint.friction", "Friction", "", "choice",
          choices=tuple((law.name, law.label) for law in FRICTIONS.values()),
          usual="symmetric"),
    _of(Gravity, "gravity.load", "Gravity", "",
        {"": "does not matter", "constant": "a vertical axis: a constant weight",
         "link": "an arm that swings in a vertical plane"}),
    _of(Transmission, "transmission.ratio", "Gear ratio",
        "How far the motor goes while the load goes 1; empty without a gear."),
    Field("joint.name", "Name", "What the report calls the axis.", "text"),
)  # fmt: skip

LAW = Field(
    "controller.law", "Its law", "How the drive makes the torque from commanded and motor position.", "choice",
    choices=(
        ("", "choose ..."),
        ("cascade", "position loop around a velocity loop (P-P or P-PI, most servo drives)"),
        ("pd", "PD on the position"),
        ("pid", "PID on the position"),
        (LEARN, "I do not know it: learn it from this record (needs the motor position)"),
        (WITHOUT, "I do not know it: do without (needs the motor position, less exact)"),
        (EXTRA_LAW, "as in the further lines below"),
    ),
)  # fmt: skip

_OF_CASCADE = {"controller.law": ("cascade",)}

CONTROLLER = (
    _of(Cascade, "controller.kp", "Position gain kp", "", when=_OF_CASCADE),
    _of(Cascade, "controller.kv", "Velocity gain kv", "", when=_OF_CASCADE),
    _of(Cascade, "controller.ki", "Integral gain ki", "1 over the integral time; empty for none.", when=_OF_CASCADE),
    _of(Cascade, "controller.velocity_feedforward", "Velocity feed-forward", "A share: 1 is all of it; empty for none.",
        when=_OF_CASCADE),
    _of(PD, "controller.kp", "Proportional gain kp", "", when={"controller.law": ("pd", "pid")}, variant="pd"),
    _of(PID, "controller.ki", "Integral gain ki", "", when={"controller.law": ("pid",)}, variant="pid"),
    _of(PD, "controller.kd", "Derivative gain kd", "", when={"controller.law": ("pd", "pid")}),
    _of(PD, "controller.velocity_filter", "Velocity filter", "Numbers that weigh this and earlier velocities: 0.5, "
        "0.5 is the mean of two. Empty for none.", when=_LAWED),
    _of(PD, "controller.gain", "Torque per controller unit", "1 if the controller speaks N or N m already; the "
        "drive's gain if it speaks volts or ampere.", unit=("N per unit", "N m per unit"),
        when={"controller.law": (*LAWS, LEARN)}),
    _of(PD, "controller.limit", "Torque limit", "Of the controller's output, both ways; empty for none.",
        when=_LAWED),
    _of(PD, "controller.delay", "Delay", "From the sampled position to the torque; empty for none.", when=_LAWED),
    _of(PD, "controller.period", "Period", "Of the controller, if it is not that of the log.", when=_LAWED),
)  # fmt: skip

METHOD = (
    _of(FlexibleDIDIM, "method.frequency", "Resonance, roughly", "Where the search for the spring begins; empty tries "
        "several.", when={"joint.model": ("flexible",), "controller.law": ("", *LAWS, LEARN, EXTRA_LAW)}),
    _of(Filtering, "filtering.cutoff", "Look up to", "The highest frequency that is compared; empty for a share of the "
        "rate of the log."),
)  # fmt: skip

CHANNEL_STEP: tuple[Field, ...] = (
    KIND, *CLOCK, *TEXT, *(one for fields in CHANNEL_FIELDS.values() for one in fields), *DRIVE,
)  # fmt: skip
JOINT_STEP: tuple[Field, ...] = (*JOINT, LAW, *CONTROLLER, *METHOD)
FIELDS: tuple[Field, ...] = (*CHANNEL_STEP, *JOINT_STEP)
NAMES = frozenset({EXTRA, *(one.name for one in FIELDS)})
"""The names that a draft may hold."""

_USUAL = {one.name: one.usual for one in FIELDS if one.usual}


def usual(name: str) -> str:
    """Return what a new form has in a field."""
    return _USUAL.get(name, "")


def time_unit(column: str) -> str:
    """Return the unit of a time column as its name has it, or s."""
    return unit_in_name(column, units_of("time")) or "s"
