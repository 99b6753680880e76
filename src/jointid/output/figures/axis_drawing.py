"""The axis as a drawing: its masses, spring and gear, with the numbers of the estimate in it.

The drawing is SVG without style, script or reference, every text of it escaped.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from jointid.common.document import typeset
from jointid.common.text import number
from jointid.common.transmission import Transmission
from jointid.estimation.problems.base import INITIAL
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import EstimatedParameter, show_value
from jointid.estimation.result.summary import field_symbol
from jointid.models.joints import FlexibleJoint

_COLUMN, _ACROSS, _LEFT, _RIGHT = 122, 3, 44, 6  # px of a column, how many there are, and px beside all of them
_LETTER = 6.7  # px, at most on average
_GEAR = 46
_TOP, _TALL = 14, 62  # of the boxes
_LINE, _PAIR = 17, 42  # between lines, and between parameters
_INK, _SOFT, _MASS, _SPRING = "#1b2733", "#53616e", "#e6f0f7", "#0b4f7d"

_RESONANCES = {"free_free": "Resonance", "motor_locked": "antiresonance", "second_free_free": "second resonance"}


def resonance_sentence(estimate: Estimate) -> str:
    """State resonance and antiresonance as the motor sees them; empty for a joint without a spring."""
    frequencies = estimate.frequencies
    named = [(words, frequencies[name]) for name, words in _RESONANCES.items() if name in frequencies]
    stated = ", ".join(f"{words} {number(hertz, 3)} Hz" for words, hertz in named)
    return f"{stated}, from motor torque to motor position." if stated else ""


def draw_axis(estimate: Estimate) -> str:
    """Draw the axis of a joint's estimate as SVG.

    Raises:
        MethodError: the estimate is of a robot.
    """
    joint = estimate.require_joint()
    rows = [row for row in estimate.params.rows if row.of_joint and row.name not in INITIAL]
    gear = joint.transmission
    left = _LEFT + (_GEAR if gear is not None else 0)
    columns = [("mass" if joint.kind == "prismatic" else "inertia", rows)]
    if isinstance(joint, FlexibleJoint):
        spring = {"damping", *(one.name for one in joint.spring.parameters)}
        motor = [row for row in rows if row.name.startswith("motor_") or row.name == "offset"]
        middle = [row for row in rows if row.name in spring]
        columns = [("motor", motor), ("", middle), ("load", [row for row in rows if row not in (*motor, *middle)])]
    across = _ACROSS // len(columns)  # values beside each other
    column = across * _COLUMN
    wide = left + len(columns) * column + _RIGHT
    parts = [_arrow(), *([] if gear is None else [_draw_gear(gear)])]
    for k, (name, shown) in enumerate(columns):
        x = left + k * column
        parts += [_draw_mass(x, column, name) if name else _draw_spring(x), *_write_values(x, across, shown)]
    rows_down = -(-max(len(shown) for _, shown in columns) // across)
    foot = _TOP + _TALL + 24 + rows_down * _PAIR + _LINE
    notes = [] if gear is None else [f"values on the {gear.side} side of the gear"]
    for one in notes:
        parts.append(_text(wide / 2, foot, one, "middle", _SOFT))
    tall = foot + (8 if notes else -_LINE)
    described = "; ".join(f"{row.name.replace('_', ' ')} {show_value(row)} {row.unit}" for row in rows)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="axis" role="img" viewBox="0 0 {wide} {tall}" '
        f'width="{wide}" height="{tall}" font-family="sans-serif" font-size="13" fill="{_INK}">'
        f"<title>{escape(typeset(f'The axis: {described}'))}</title>{''.join(parts)}</svg>"
    )


def _write_values(x: float, across: int, rows: Sequence[EstimatedParameter]) -> list[str]:
    """Return name, unit and value of each parameter below a column, some beside each other."""
    found = []
    for k, row in enumerate(rows):
        y, middle = _TOP + _TALL + 24 + k // across * _PAIR, x + (k % across + 0.5) * _COLUMN
        name = row.name.removeprefix("motor_").removeprefix("load_").replace("_", " ").replace("coulomb", "Coulomb")
        label = ", ".join(filter(None, (f"{name} {field_symbol(row)}".strip(), row.unit)))
        found.append(_text(middle, y, label, "middle", _SOFT, _COLUMN))
        found.append(_text(middle, y + _LINE, show_value(row), "middle", _INK, _COLUMN, bold=True))
    return found


def _text(x: float, y: float, text: str, anchor: str, fill: str, most: float = 1e3, *, bold: bool = False) -> str:
    """Return a line of text, condensed to `most` px where it may be wider."""
    text = typeset(text)
    more = ' font-weight="700"' if bold else ""
    if _LETTER * len(text) > most:
        more += f' textLength="{most - 8:g}" lengthAdjust="spacingAndGlyphs"'
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" fill="{fill}"{more}>{escape(text)}</text>'


def _arrow() -> str:
    y = _TOP + _TALL / 2
    return (
        f'<path d="M4 {y}H{_LEFT - 8}m-8 -5l8 5l-8 5" fill="none" stroke="{_INK}" stroke-width="1.5"/>'
        f"{_text(4, y - 9, 'torque', 'start', _SOFT)}"
    )


def _draw_gear(gear: Transmission) -> str:
    y, x = _TOP + _TALL / 2, _LEFT + 8
    size = f"{gear.ratio:g}:1" if gear.ratio is not None else f"{1e3 * (gear.lead or 0.0):g} mm"
    wheels = f'<circle cx="{x}" cy="{y}" r="8"/><circle cx="{x + 22}" cy="{y}" r="14"/>'
    return (
        f'<g fill="#fff" stroke="{_INK}" stroke-width="1.5">{wheels}</g>'
        f"{_text(x + 14, y + 30, size, 'middle', _INK, bold=True)}"
    )


def _draw_mass(x: float, wide: float, name: str) -> str:
    y, base = _TOP + _TALL / 2, _TOP + _TALL
    return (
        f'<rect x="{x + 8}" y="{_TOP}" width="{wide - 16}" height="{_TALL - 8}" rx="4" fill="{_MASS}" '
        f'stroke="{_SPRING}" stroke-width="1.5"/>{_text(x + wide / 2, y, name, "middle", _INK)}'
        f'<path d="M{x + 8} {base}h{wide - 16}" stroke="{_SOFT}" stroke-dasharray="3 3"/>'
    )


def _draw_spring(x: float) -> str:
    """Return a spring over a damper, between the masses at both sides."""
    high, low, start, length = _TOP + 14, _TOP + 42, x - 8, _COLUMN + 16
    third = length / 3
    coil = "".join(f"l{third / 8:g} {dy}" for dy in (-7, 14, -14, 14, -14, 14, -14, 7))
    middle = start + length / 2
    return (
        f'<g fill="none" stroke="{_SPRING}" stroke-width="1.8"><path d="M{start} {high}h{third:g}{coil}h{third:g}"/>'
        f'<path d="M{start} {low}H{middle - 4:g}m0 -7v14M{middle + 10:g} {low - 10}h-22v20h22M{middle + 10:g} {low}'
        f'H{start + length}"/></g>'
    )
