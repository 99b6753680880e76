"""`jointid simulate`: the loop of a joint file, driven by a record's reference."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def simulate(
    joint: Path,
    /,
    *,
    record: Path | None = None,
    estimate: Path | None = None,
    out: Path | None = None,
    json: Path | None = None,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Simulate a joint under its controller and write what its drive would log.

    The parameters are those of an estimate, or the fixed values and starts of the joint file.

    Args:
        joint: the joint file (TOML).
        record: the record whose reference (and injected signal) drives the loop.
        estimate: what identify --json wrote; its parameters are used.
        out: write torque, reference and positions to this file, CSV or MAT.
        json: also write a summary as JSON to this file.
        quiet: say nothing of the progress.
    """
    from jointid import answers
    from jointid.cli.console import check_outputs, progress, ready, show
    from jointid.common.errors import MethodError
    from jointid.jointfile import load
    from jointid.simulation.closed_loop import prepare, require_finished
    from jointid.simulation.closed_loop import simulate as run

    check_outputs(None, json, out)
    file = load(joint)
    if estimate is not None:
        file = file.overridden(friction=answers.read_friction(estimate))
    if file.loop is None:
        raise MethodError("A simulation needs the controller; add a [controller] table to the joint file.")
    logged = file.record(record)
    values = file.values() if estimate is None else answers.read_identified(estimate, file.joint, file.loop).values
    ready(progress(quiet))
    simulation = require_finished(run(file.loop, prepare(file.loop, logged), values))
    peak = float(abs(simulation.torque).max())
    show(
        f"{simulation.torque.size} samples of {simulation.sample_time:g} s: peak torque {peak:.5g}, "
        f"{simulation.events} reversals, stops and starts, {100 * simulation.at_limit:.2f} % of the time at the limit"
    )
    if out is not None:
        from jointid.data.reading import write
        from jointid.simulation.synthesis import as_record

        write(as_record(logged, simulation), out)
    if json is not None:
        answers.write(answers.simulation_answer(simulation, file.joint, values, logged.name), json)
