"""The kinds of values a joint file has, each with the words for what is expected of it."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field

from jointid.common.messages import Says
from jointid.common.units import units_of

_TIME_UNITS = units_of("time")
_LENGTH_UNITS = units_of("length")
MOST = 10**9
"""Of what is counted."""


def _not_nan(value: float) -> float:
    if math.isnan(value):
        raise ValueError
    return value


def _dotted(value: object) -> object:
    """Return a table of tables as one, of names with points: TOML reads ``filter.depth = 0.1`` as a table below."""
    if not isinstance(value, dict):
        return value
    found: dict[str, object] = {}
    for key, below in value.items():
        inner = _dotted(below)
        found |= {f"{key}.{name}": one for name, one in inner.items()} if isinstance(inner, dict) else {key: inner}
    return found


def _direction(value: int) -> int:
    if value not in (1, -1):  # Literal[1, -1] would take true for 1
        raise ValueError
    return value


def _time_unit(name: str) -> str:
    if name not in _TIME_UNITS:
        raise ValueError
    return name


def _length_unit(name: str) -> str:
    if name not in _LENGTH_UNITS:
        raise ValueError
    return name


Text = Annotated[str, Field(min_length=1), Says("text in quotes")]
TimeUnit = Annotated[str, AfterValidator(_time_unit), Says(f"a unit of time, one of {', '.join(_TIME_UNITS)}")]
LengthUnit = Annotated[str, AfterValidator(_length_unit), Says(f"a unit of length, one of {', '.join(_LENGTH_UNITS)}")]
Flag = Annotated[bool, Says("true or false")]

Number = Annotated[float, Field(allow_inf_nan=False), Says("a number")]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False), Says("a positive number")]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False), Says("a number, 0 or more")]
Bound = Annotated[float, AfterValidator(_not_nan), Says("a number, inf or -inf")]
Limit = Annotated[float, Field(gt=0), Says("a positive number")]
"""A limit may be infinite."""

Size = Annotated[
    float, Field(gt=0, allow_inf_nan=False), Says("a positive number", "use sign = -1 to turn the load round")
]
ColumnGain = Annotated[
    float, Field(gt=0, allow_inf_nan=False), Says("a positive number", "use sign = -1 to turn the channel round")
]
LoopGain = Annotated[
    float,
    Field(ge=0, allow_inf_nan=False),
    Says("a number, 0 or more", "turn the torque or the positions round, with sign = -1 on their channels"),
]
OutputGain = Annotated[
    float,
    Field(gt=0, allow_inf_nan=False),
    Says("a positive number", "turn the torque round, with sign = -1 on its channel"),
]
Sign = Annotated[
    int, AfterValidator(_direction), Field(json_schema_extra={"enum": [1, -1]}), Says("1 or -1", "use gain to scale")
]

Natural = Annotated[int, Field(ge=0, le=MOST), Says("a whole number, 0 or more")]
Count = Annotated[int, Field(ge=1, le=MOST), Says("a whole number, 1 or more")]
Borders = Annotated[list[Natural], Field(min_length=2, max_length=2), Says("a list of two whole numbers, 0 or more")]

Names = Annotated[list[Text], Says("a list of names in quotes")]
Numbers = Annotated[list[Number], Says("a list of numbers")]
Coefficients = Annotated[list[Number], Field(min_length=1), Says("a list of one or more numbers")]
Matrix = Annotated[list[list[Number]], Says("a list of rows, each a list of numbers")]
ControllerNumbers = Annotated[dict[str, Number], BeforeValidator(_dotted)]
"""By their names, those of a filter with points."""
