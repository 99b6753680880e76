"""The kinds of values a joint file has, each with the words for what is expected of it."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field

from jointid.common.messages import Says
from jointid.common.units import units_of

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


def _length_unit(name: str) -> str:
    if name not in _LENGTH_UNITS:
        raise ValueError
    return name


Text = Annotated[str, Field(min_length=1), Says("text in quotes")]
LengthUnit = Annotated[str, AfterValidator(_length_unit), Says(f"a unit of length, one of {', '.join(_LENGTH_UNITS)}")]
Flag = Annotated[bool, Says("true or false")]

Number = Annotated[float, Field(allow_inf_nan=False), Says("a number")]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False), Says("a positive number")]
Bound = Annotated[float, AfterValidator(_not_nan), Says("a number, inf or -inf")]

Size = Annotated[
    float, Field(gt=0, allow_inf_nan=False), Says("a positive number", "use sign = -1 to turn the load round")
]

Natural = Annotated[int, Field(ge=0, le=MOST), Says("a whole number, 0 or more")]
Borders = Annotated[list[Natural], Field(min_length=2, max_length=2), Says("a list of two whole numbers, 0 or more")]

Names = Annotated[list[Text], Says("a list of names in quotes")]
Numbers = Annotated[list[Number], Says("a list of numbers")]
Coefficients = Annotated[list[Number], Field(min_length=1), Says("a list of one or more numbers")]
Matrix = Annotated[list[list[Number]], Says("a list of rows, each a list of numbers")]
ControllerNumbers = Annotated[dict[str, Number], BeforeValidator(_dotted)]
"""By their names, those of a filter with points."""
