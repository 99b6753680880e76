"""The commands `jointid simulate` and `reproduce`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jointid.apps.cli.console import DEFAULTS, Options, Quiet, listen, ready, show
from jointid.common.errors import MethodError
from jointid.common.files import require_room

if TYPE_CHECKING:
    from jointid import Estimate
    from jointid.config import File


def simulate(
    joint: Path,
    /,
    *,
    options: Options = DEFAULTS,
    estimate: Path | None = None,
    out: Path | None = None,
) -> None:
    """Simulate a joint or a robot under its controller.

    It is driven by the reference of a record, and what its drive would log is written.
    The reference of --record, and the injected signal if it has one, drive the loop; --json takes a summary. The
    parameters are those of an estimate, or the fixed values and starts of the file.

    Args:
        joint: the joint file (TOML), or a robot file, which has the table [robot].
        options: those that most commands have.
        estimate: what identify --json wrote; its parameters are used.
        out: write torque, reference and positions to this file, of any format, under the names and in the
            units in which the joint file, or its drive's profile, reads them, each on its own side of a transmission.
    """
    from jointid.output.json import load_estimate, write

    file = options.load(joint, out, estimate=estimate)
    found = None if estimate is None else load_estimate(estimate, file)
    simulation, logged, answer = (_simulate_joint if file.robot is None else _simulate_robot)(file, found, options)
    peaks = abs(simulation.torque).reshape(len(simulation.torque), -1).max(axis=0)
    of_each = (
        f"{axis.name or ''} {peak:.5g} {axis.joint.force_unit}" for axis, peak in zip(file.axes, peaks, strict=True)
    )
    show(
        f"{len(simulation.torque)} samples of {simulation.sample_time:g} s, {simulation.events} reversals, stops and "
        f"starts; peak torque: {', '.join(map(str.lstrip, of_each))}"
    )
    if out is not None:
        file.write(logged, out)
        show(f"Written: {out}")
    if options.json is not None:
        write(answer, options.json)


def _simulate_joint(file: File, estimate: Estimate | None, options: Options) -> tuple[Any, Any, Any]:
    """Return the simulation of a joint, what its drive would log, and its document."""
    from jointid import simulate as run
    from jointid.output.json import simulation_answer
    from jointid.simulation.simulate import require_success

    if file.loop is None:
        raise MethodError("A simulation needs the controller; add a [controller] table to the joint file.")
    # What is written begins with its first sample, from where a position loop's offset will be counted.
    driven = replace(file.record(options.record, driving=True), begin=0.0)
    values = file.axis.values() if estimate is None else estimate.require_values()
    ready(options.progress, derivatives=False)
    found = require_success(run(file.loop, driven, values))
    show(f"{100 * found.at_limit:.2f} % of the time at the limit")
    stated = {"resampled": driven.resampled, "parameters": values, "at_limit": found.at_limit}
    (logged,) = found.records([driven], file.joint.force_unit)
    return found, logged, simulation_answer(found, driven.name, stated)


def _simulate_robot(file: File, estimate: Estimate | None, options: Options) -> tuple[Any, Any, Any]:
    """Return the simulation of a robot, what its drives would log, and its document."""
    from jointid import simulate as run
    from jointid.output.json import simulation_answer
    from jointid.simulation.simulate import require_success
    from jointid.simulation.synthesis import tracking_errors

    loop, driven = file.loop, file.record(options.record, driving=True)
    robot = loop.robot
    if estimate is not None:
        loop = replace(loop, robot=estimate.require_robot().robot())
    found = require_success(run(loop, driven), f"The simulation of {robot.name}")
    astray = tracking_errors(driven, found)
    for k, off in astray.items():
        show(
            f"{robot.names[k]} does not follow its reference: it gets {off:.3g} {robot.position_unit(k)} off it; check "
            "its controller's gains and limit, and its signs."
        )
    strays = {robot.names[k]: off for k, off in astray.items()}
    answer = simulation_answer(found, robot.name, {"joints": robot.names, "strays": strays})
    return found, found.records(driven), answer


def reproduce(*, out: Path = Path("jointid-reproduction"), seed: int = 1, quiet: Quiet = False) -> None:
    """Run the paper end to end on its digital twin.

    Its tables show printed, recomputed and newly identified values.

    Args:
        out: folder for the HTML page, the Markdown page and the figures; it is made if it is not there.
        seed: of the noise; the same seed gives the same bytes.
        quiet: say nothing of the progress.
    """
    from jointid.common.charts import render
    from jointid.output.figures import torque
    from jointid.output.report.sections import save
    from jointid.paper.reproduce import report_reproduction
    from jointid.paper.reproduce import reproduce as run

    require_room(out)
    ready(listen(quiet))
    report = report_reproduction(run(seed, listen(quiet)), lambda answer: render(torque(answer), "png", 100))
    written = save(report, out, "reproduction")
    show(f"Written: {', '.join(map(str, written))}")
