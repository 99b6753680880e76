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

from jointid import PD, PID, Cascade, Column, Drive, Filtering, FlexibleDIDIM, Gravity, Transmission, filters
from jointid.common.settings import Declared, settings_of
from jointid.common.units import UnitError, spelled, unit, units_of
from jointid.config.schema_record import Source
from jointid.models.friction import FRICTIONS
from jointid.models.springs import SPRINGS
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

_DIGITS = r"[+-]?([0-9]+[.,]?[0-9]*|[.,][0-9]+)([eE][+-]?[0-9]+)?"
_NUMBER = re.compile(_DIGITS)
_WITH_UNIT = re.compile(rf"({_DIGITS})\s*([^\s0-9.,;][^;]*)")
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
                    return self._number(text)
                case "numbers":
                    return _decimals(text)
                case "sign":
                    return {"1": 1, "-1": -1}.get(text, text)
                case "flag":
                    return {"true": True, "false": False}.get(text, text)
        except ValueError:
            pass
        return text

    def _number(self, text: str) -> float:
        """Return a number as the joint file has it: in the field's unit, or with another one of its kind behind it.

        Raises:
            ValueError: it is none.
        """
        found = None if _NUMBER.fullmatch(text) else _WITH_UNIT.fullmatch(text)
        value = _decimal(text) if found is None else _decimal(found[1]) * _factor(found[4], self.unit[0])
        return int(value) if self.whole and value.is_integer() else value

    def number_fault(self, draft: Draft) -> str | None:
        """Return what is said of a text where numbers belong, None where there is nothing to say."""
        text = self.read(draft)
        if self.form not in ("number", "numbers") or not isinstance(text, str):
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
    """Return the numbers of a list, such as "0.5, 0.5", "0,5; 0,5" or "[0.5,0.5]".

    Raises:
        ValueError: one is none, or it cannot be told whether a comma stands in a number or between two.
    """
    text = text.strip("[] \t")
    if "." in text and "," in text:
        return [_decimal(part) for part in text.split(",")]
    if re.fullmatch(r"[0-9]+,[0-9]+", text):
        raise ValueError
    return [_decimal(part) for part in _BETWEEN.split(text)]


def _factor(name: str, own: str) -> float:
    """Return what takes a number in the named unit to the field's own.

    Raises:
        ValueError: one of them is not in the table, or they measure different things.
    """
    try:
        given, wanted = unit(spelled(name)), unit(own)
    except UnitError:
        raise ValueError from None
    if given.dimension != wanted.dimension:
        raise ValueError
    return given.factor / wanted.factor


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
        key,
        label,
        said,
        **{"form": _form(one), "unit": _units(one.setting.unit), "choices": choices, "whole": one.type is int}
        | further,
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
    "joint.kind", "How it moves", "As its motor does, if there is a gear or a screw. The units to choose "
    "from follow it.", "choice",
    choices=(("", "choose ..."), ("prismatic", "straight: m and N (a linear axis)"),
             ("revolute", "it turns: rad and N m")),
)  # fmt: skip

_SIDES = {"": "the usual", "motor": "the motor's", "load": "the load's"}

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
              choices=(("", "choose ..."), *((u, u) for u in known_units(channel, kind))))
        for kind in ("prismatic", "revolute")
    )  # fmt: skip
    made = [
        _of(Column, f"{path}.column", *CHANNEL_WORDS[channel], form="column"),
        *units,
        _of(Column, f"{path}.gain", "Multiply by", "What takes the column to the unit; empty for 1."),
        _of(Column, f"{path}.sign", "Direction", "", {"1": "as it is", "-1": "turned round"}),
        _of(Column, f"{path}.timing", "A value stands for", "",
            {"": "the usual", "sampled": "its instant", "held": "the time until the next one",
             "averaged": "the mean since the last one"}),
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
    made.append(_of(Column, f"{path}.side", "Side of the gear", "Only with a gear.", _SIDES))
    return tuple(made)


CHANNEL_FIELDS = {channel: channel_fields(channel) for channel in CHANNELS}

DRIVE = (
    Field(
        "joint.torque_constant",
        "Torque constant",
        "Takes a current to a torque, and the controller's output too.",
        "number",
        unit=("N per A", "N m per A"),
    ),
    _of(Drive, "drive.rated_torque", "Rated torque", "What % and per mille are a share of."),
    _of(Drive, "drive.counts_per_turn", "Encoder counts in one turn", "", when={"joint.kind": ("revolute",)}),
    _of(Drive, "drive.counts_per_metre", "Encoder counts in one metre", "", when={"joint.kind": ("prismatic",)}),
)

JOINT = (
    Field("joint.model", "What is looked for", "Flexible needs a motion that excites the spring.", "choice",
          choices=(("rigid", "rigid: one mass and its friction"),
                   ("flexible", "flexible: two masses, a spring")), usual="rigid"),
    Field("joint.friction", "Friction", "jointid diagnose friction says which one a record shows.", "choice",
          choices=tuple((law.name, law.label) for law in FRICTIONS.values()),
          usual="symmetric"),
    Field("joint.spring", "Spring", "jointid diagnose springs says which one a record shows.", "choice",
          when={"joint.model": ("flexible",)}, usual="linear",
          choices=tuple((name, law.label) for name, law in SPRINGS.items())),
    _of(Gravity, "gravity.load", "Gravity", "",
        {"": "does not matter", "constant": "a vertical axis: a constant weight",
         "link": "an arm that swings up and down"}),
    _of(Transmission, "transmission.ratio", "Gear ratio",
        "How far the motor goes while the load goes 1; empty without a gear."),
    Field("joint.name", "Name", "What the report calls the axis.", "text"),
)  # fmt: skip


def _filter_fields(path: str, label: str, where: str) -> tuple[Field, ...]:
    """Return the fields of a filter, of the kinds that a number or two describe."""

    def of(kind: str) -> dict[str, tuple[str, ...]]:
        return {**_LAWED, f"{path}.kind": (kind,)}

    return (
        Field(f"{path}.kind", label, where, "choice", when=_LAWED,
              choices=(("", "none"), ("first_order", "first order, by its time constant"),
                       ("moving_average", "mean of some samples"), ("digital", "by its numbers (taps)"))),
        _of(filters.FirstOrder, f"{path}.time_constant", "Its time constant", "Such as 0.0008 or 0.8 ms; 1 / (2 pi f) "
            "of a cut-off frequency f.", when=of("first_order")),
        _of(filters.MovingAverage, f"{path}.samples", "Mean of so many samples", "", when=of("moving_average")),
        _of(filters.DigitalFilter, f"{path}.numerator", "Its numbers", "They weigh this and earlier values: 0.5; 0.5 "
            "is the mean of two.", when=of("digital")),
    )  # fmt: skip


LAW = Field(
    "controller.law", "Its law", "Most servo drives have a cascade: P for the position, P or PI for the speed. What "
    "is not known can be learned, or done without, less exactly, from a record with the motor position.", "choice",
    choices=(
        ("", "choose ..."),
        ("cascade", "cascade: position and speed loop"),
        ("pd", "PD on the position"),
        ("pid", "PID on the position"),
        (LEARN, "not known: learn it from this record"),
        (WITHOUT, "not known: do without it"),
        (EXTRA_LAW, "in the further lines below"),
    ),
)  # fmt: skip

_OF_CASCADE = {"controller.law": ("cascade",)}

CONTROLLER = (
    _of(Cascade, "controller.position_gain", "Position gain Kv", "Of the position loop: velocity per position error. "
        "A Kv in 1000/min is 16.67 times as large in 1/s.", when=_OF_CASCADE),
    _of(Cascade, "controller.velocity_gain", "Velocity gain Kp", "Of the speed loop: torque, current or voltage per "
        "velocity error.", unit=("N s/m, A s/m or V s/m", "N m s/rad, A s/rad or V s/rad"), when=_OF_CASCADE),
    Field("controller.integral_time", "Integral time Tn", "Of the speed loop, such as 0.006 or 6 ms; empty for none.",
          "number", unit=("s", "s"), when=_OF_CASCADE),
    _of(Cascade, "controller.velocity_feedforward", "Velocity feed-forward", "A share: 1 is all of it; empty for none.",
        when=_OF_CASCADE),
    _of(PD, "controller.position_gain", "Proportional gain", "Torque, current or voltage per position error.",
        unit=("N/m, A/m or V/m", "N m/rad, A/rad or V/rad"), when={"controller.law": ("pd", "pid")}, variant="pd"),
    _of(PID, "controller.integral_gain", "Integral gain", "", variant="pid", when={"controller.law": ("pid",)},
        unit=("N/(m s), A/(m s) or V/(m s)", "N m/(rad s), A/(rad s) or V/(rad s)")),
    _of(PD, "controller.derivative_gain", "Derivative gain", "", when={"controller.law": ("pd", "pid")},
        unit=("N s/m, A s/m or V s/m", "N m s/rad, A s/rad or V s/rad")),
    *_filter_fields("controller.velocity_filter", "Velocity filter", "Of the measured velocity."),
    *_filter_fields("controller.torque_filters.0", "Torque filter", "Of the torque or current setpoint."),
    _of(PD, "controller.gain", "Torque per controller unit", "Empty if the gains above give N or N m; or else what "
        "1 A or 1 V of theirs is in N or N m.", unit=("N per A or V", "N m per A or V"),
        when={"controller.law": (*LAWS, LEARN), "joint.torque_constant": ("",)}),
    _of(PD, "controller.limit", "Torque limit", "Of the controller's output, both ways; empty for none.",
        unit=("N, A or V", "N m, A or V"), when=_LAWED),
    _of(PD, "controller.delay", "Delay", "From the sampled position to the torque; empty for none.", when=_LAWED),
    _of(PD, "controller.period", "Period", "Of the controller, if it is not that of the log.", when=_LAWED),
    Field("controller.side", "Side of the gear", "Only with a gear: whose positions and torque these numbers are of.",
          "choice", choices=tuple(_SIDES.items()), when=_LAWED),
)  # fmt: skip

METHOD = (
    _of(FlexibleDIDIM, "method.frequency", "Resonance, roughly", "Where the search for the spring begins; empty tries "
        "several.", when={"joint.model": ("flexible",), "controller.law": ("", *LAWS, LEARN, EXTRA_LAW)}),
    _of(Filtering, "filtering.cutoff", "Look up to", "The highest frequency that is compared; empty for a share of the "
        "rate of the log."),
    _of(Transmission, "transmission.side", "Values on the side of", "Only with a gear: where they are told.",
        {"": "the load", "load": "the load", "motor": "the motor"}),
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
