"""The estimate of a robot as a document: answer, checks, errors by axis, parameters and their sums."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Document, Facts, Heading, Listing, Paragraph, Table, Tone
from jointid.common.errors import MethodError
from jointid.common.text import interval, number
from jointid.estimation.result.answer import Trust, answer_of
from jointid.estimation.result.parts import EstimatedParameter, EstimateParts
from jointid.models.robots.robot import Robot

_SHOWN = 1.0  # relative standard error: a parameter that is known worse stands in the details only
_TONES: dict[Trust, Tone] = {Trust.RELIABLE: "good", Trust.NOT_YET: "bad"}


def robot_blocks(estimate: EstimateParts, *, details: bool = False) -> tuple[Block, ...]:
    """Return errors by axis, parameters and sums.

    Args:
        estimate: of a robot.
        details: whether the parameters that this record does not tell from 0 are listed, and the sums behind all.
    """
    part = estimate.require_robot()
    errors = {"estimate": np.array([*estimate.fit.axis_errors.values()])}
    if part.model.has_masses:
        errors["nominal"] = part.nominal_errors
    listed = [
        (row, nominal)
        for row, nominal in zip(estimate.params.rows, part.nominal, strict=True)
        if details
        or not row.free
        or row.value is None
        or row.at_bound is not None
        or (row.stderr or 0.0) < _SHOWN * abs(row.value)
    ]
    listed = [(row, nominal) for row, nominal in listed if row.value is not None or row.lower_bound is not None]
    hidden = len(part.names) - len(listed)
    caption = f"{hidden} more are not told from 0 by this record" if hidden else ""
    rows = tuple((row.symbol, *_cells(row), number(float(nominal), 4)) for row, nominal in listed)
    # A base parameter has the name of a sum; what has the name of a joint's number and is a sum always says so.
    sums = tuple(
        f"{row.name} is {formula}"
        for row, formula in zip(estimate.params.rows, part.formulas, strict=True)
        if row.symbol != formula and (details or row.name != row.symbol)
    )
    return (
        errors_table(part.model, errors, "of the record it was identified from"),
        Table(("symbol", "parameter", "value, 2 sigma", "unit", "sigma, %", "nominal"), rows, caption, (0, 1, 2, 3)),
        *((Heading("Sums that the parameters stand for"), Listing(sums)) if sums else ()),
    )


def describe_robot_estimate(estimate: EstimateParts, verdicts: tuple[Block, ...], *, details: bool = False) -> Document:
    """Return the estimate of a robot as a document; see `describe_estimate`."""
    part, answer = estimate.require_robot(), answer_of(estimate)
    tone = _TONES.get(Trust(answer.trust.code), "open")
    return Document(
        f"{part.model.name}: {len(part.names)} parameters of {len(part.model)} joints",
        (
            Paragraph(str(answer), lead=True, tone=tone),
            *verdicts,
            Facts(tuple(("warning", warning) for warning in estimate.checks.warnings)),
            *(Paragraph(f"{one}.") for one in part.springs),
            Facts((("method", estimate.settings.variant), ("search", estimate.fit.stop))),
            *robot_blocks(estimate, details=details),
        ),
    )


def _cells(row: EstimatedParameter) -> tuple[str, str, str, str]:
    if row.value is None:
        assert row.lower_bound is not None
        return row.name, f"at least {number(row.lower_bound, 3)}", row.unit, ""
    if row.stderr is None or row.at_bound is not None:
        return row.name, interval(row.value, 0.0), row.unit, "fixed" if row.at_bound is None else "at its bound"
    share = row.stderr / max(abs(row.value), 1e-300)
    return row.name, interval(row.value, 2 * row.stderr), row.unit, f"{100 * share:.2g}"


def errors_table(robot: Robot, columns: Mapping[str, FloatArray], of_what: str) -> Table:
    """Return the errors of the joints as a table, a column for each model, in per cent.

    Raises:
        MethodError: a joint has no torque to explain.
    """
    for errors in columns.values():
        if np.any(np.isnan(errors)):
            raise MethodError("A joint's torque is 0 throughout; expected a torque of every motor: check the channels.")
    rows = tuple(
        (name, *(f"{100 * errors[k]:.3g}" if np.isfinite(errors[k]) else "runs away" for errors in columns.values()))
        for k, name in enumerate(robot.names)
    )
    header = ("joint", *(f"{name}, %" for name in columns))
    return Table(header, rows, f"filtered torque that is left, {of_what}")
