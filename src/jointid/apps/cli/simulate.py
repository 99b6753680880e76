"""`jointid simulate`: the loop of a joint file, driven by a record's reference; or the paper's digital twin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from jointid.apps.cli.options import Changes


def simulate(
    joint: Path | None = None,
    /,
    *,
    record: Path | None = None,
    changes: Changes = (),
    estimate: Path | None = None,
    out: Path | None = None,
    json: Path | None = None,
    twin: Literal["L19", "L30"] | None = None,
    added_mass: Annotated[bool, Parameter(negative=())] = False,
    noise: Literal["disturbance", "white", "none"] = "disturbance",
    seed: int = 1,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Simulate a joint under its controller and write what its drive would log.

    The parameters are those of an estimate, or the fixed values and starts of the joint file. With --twin no joint file
    is needed: the paper's flexible axis is simulated, under one of its two loops.

    Args:
        joint: the joint file (TOML).
        record: the record whose reference (and injected signal) drives the loop.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times.
        estimate: what identify --json wrote; its parameters are used.
        out: write torque, reference and positions to this file, of any format, under the names and in the
            units in which the joint file, or its drive's profile, reads them, each on its own side of a transmission.
        json: also write a summary as JSON to this file.
        twin: the paper's digital twin instead, under this loop.
        added_mass: of the twin: with 10 kg on the load.
        noise: of the twin: a force inside the loop, white noise on the log, or none.
        seed: of the twin's noise.
        quiet: say nothing of the progress.
    """
    from jointid.apps.cli.console import check_outputs
    from jointid.common.errors import MethodError

    check_outputs(None, json, out)
    if twin is not None:
        if out is None or changes or any(g is not None for g in (joint, record, estimate, json)):
            raise MethodError(
                "--twin needs --out, and takes no joint file, --record, --set, --estimate or --json; give only where "
                "to write."
            )
        _twin(twin, added_mass, noise, seed, out, quiet)
        return
    if joint is None:
        raise MethodError("A simulation needs a joint file; name one, or give --twin L19 for the paper's axis.")
    _joint(joint, record, changes, estimate, out, json, quiet)


def _joint(
    joint: Path,
    record: Path | None,
    changes: tuple[str, ...],
    estimate: Path | None,
    out: Path | None,
    json: Path | None,
    quiet: bool,
) -> None:
    from jointid import prepare, simulate
    from jointid.apps.cli.console import progress, ready, show
    from jointid.common.errors import MethodError
    from jointid.common.transmission import transmission_lines
    from jointid.config import load
    from jointid.output import json as answers
    from jointid.simulation.closed_loop import require_finished

    file = load(joint, changes)
    if estimate is not None:
        file = file.override(friction=answers.read_friction(estimate))
    if file.loop is None:
        raise MethodError("A simulation needs the controller; add a [controller] table to the joint file.")
    # What is written begins with its first sample, from where a position loop's offset will be counted.
    logged = replace(file.record(record), begin=0.0)
    listener = progress(quiet)
    if estimate is None:
        values = file.values()
    else:
        identified = answers.read_identified(estimate, file.joint, file.loop)
        values = identified.values
        if identified.effects:
            listener("the estimate's ripple and drift are left out, which the simulated loop does not have")
    ready(listener, derivatives=False)
    simulation = require_finished(simulate(file.loop, prepare(file.loop, logged), values))
    peak = float(abs(simulation.torque).max())
    for line in transmission_lines(file.joint.transmission):
        show(line)
    show(
        f"{simulation.torque.size} samples of {simulation.sample_time:g} s: peak torque {peak:.5g}, "
        f"{simulation.events} reversals, stops and starts, {100 * simulation.at_limit:.2f} % of the time at the limit"
    )
    if out is not None:
        from jointid.simulation.synthesis import as_record

        file.write(as_record(logged, simulation), out)
    if json is not None:
        answers.write(answers.simulation_answer(simulation, file.joint, values, logged.name, logged.resampled), json)


def _twin(
    loop: Literal["L19", "L30"],
    added_mass: bool,
    noise: Literal["disturbance", "white", "none"],
    seed: int,
    out: Path,
    quiet: bool,
) -> None:
    from jointid import twin, write
    from jointid.apps.cli.console import progress, ready, show

    ready(progress(quiet), derivatives=False)
    axis = twin(loop, added_mass=added_mass, noise=noise, seed=seed)
    write(axis.record, out)
    symbols = {p.name: p.symbol for p in axis.loop.joint.parameters}
    truth = ", ".join(f"{symbols[name]} {value:g}" for name, value in axis.truth.items())
    show(f"{axis.record.name}, {noise} noise of {axis.noise:.3g} N at 1 kHz: {truth}")
    show(f"Written: {out}")
