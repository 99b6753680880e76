"""The text of a field and the value of its key in the joint file, each from the other."""

from __future__ import annotations

import re
from typing import Any

from jointid.apps.web.fields import Draft, Field

_EXPONENT = r"([eE][+-]?[0-9]+)?"
_NUMBER = re.compile(rf"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+){_EXPONENT}")
_COMMA = re.compile(rf"(?<![0-9,])[+-]?[0-9]+,[0-9]+{_EXPONENT}(?![0-9,])")  # one that may be a decimal mark


def value_of(one: Field, text: str) -> Any:
    """Return a field's text as the joint file has it; what is none is left as it is, for the schema to refuse."""
    try:
        match one.form:
            case "number":
                return _decimal(text)
            case "numbers":
                return [_decimal(part) for part in text.strip("[]").split(";" if ";" in text else ",")]
            case "sign":
                return {"1": 1, "-1": -1}.get(text, text)
            case "flag":
                return {"true": True, "false": False}.get(text, text)
            case _:
                return text
    except ValueError:
        return text


def _decimal(text: str) -> float:
    """Return a plain decimal number; Python reads more as one, such as 1_0 and the digits of other scripts.

    Raises:
        ValueError: it is none.
    """
    if not _NUMBER.fullmatch(text.strip()):
        raise ValueError
    return float(text)


def no_number(one: Field, draft: Draft) -> str | None:
    """Return what is said of a text where numbers belong, None where there is nothing to say."""
    text = draft.get(one.name, one.usual).strip()
    if one.form not in ("number", "numbers") or not text or not isinstance(value_of(one, text), str):
        return None
    if comma := _COMMA.search(text):
        return f'{one.label} is "{text}"; expected a number with a decimal point: write {comma[0].replace(",", ".")}.'
    return f'{one.label} is "{text}"; expected a number in plain digits, such as 12.5 or 1e-3: correct it.'


def shown_as(one: Field, value: Any) -> str | None:
    """Return a value of a joint file as its field shows it; None where the field cannot."""
    text = None
    match one.form:
        case "number" if isinstance(value, int | float) and not isinstance(value, bool):
            text = repr(value)
        case "numbers" if isinstance(value, list) and all(isinstance(item, int | float) for item in value):
            text = ", ".join(map(repr, value))
        case "flag" if isinstance(value, bool):
            text = str(value).lower()
        case "sign" if value in (1, -1):
            text = str(value)
        case "choice" | "unit" if isinstance(value, str) and value in dict(one.choices):
            text = value
        case "text" | "column" if isinstance(value, str):
            text = value
    return text
