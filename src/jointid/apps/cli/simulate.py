"""The commands `jointid simulate` and `reproduce`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from jointid.apps.cli.console import DEFAULTS, Options, Quiet, fresh_folder, listen, ready, show
from jointid.common.errors import MethodError
from jointid.common.files import require_room
from jointid.common.text import in_words, interval

if TYPE_CHECKING:
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
    file = options.load(joint, options.json, out, estimate=estimate)
    if file.robot is None:
        _simulate_joint(file, estimate, out, options)
    else:
        _simulate_robot(file, estimate, out, options)


def _simulate_joint(file: File, estimate: Path | None, out: Path | None, options: Options) -> None:
    from jointid import simulate as run
    from jointid.models.disturbances import EncoderOffset
    from jointid.output import json as answers
    from jointid.simulation.simulated import require_success

    if file.loop is None:
        raise MethodError("A simulation needs the controller; add a [controller] table to the joint file.")
    # What is written begins with its first sample, from where a position loop's offset will be counted.
    logged = replace(file.driving(options.record), begin=0.0)
    if estimate is None:
        values = file.axis.values()
    else:
        identified = answers.load_estimate(estimate, file).identified
        values = identified.values
        if any(not isinstance(effect, EncoderOffset) for effect in identified.effects):
            options.progress("the estimate's ripple and drift are left out, which the simulated loop does not have")
    ready(options.progress, derivatives=False)
    simulation = require_success(run(file.loop, logged, values))
    peak = float(abs(simulation.torque).max())
    if file.joint.transmission is not None:
        show(f"transmission: {file.joint.transmission}")
    show(
        f"{simulation.torque.size} samples of {simulation.sample_time:g} s: peak torque {peak:.5g}, "
        f"{simulation.events} reversals, stops and starts, {100 * simulation.at_limit:.2f} % of the time at the limit"
    )
    if out is not None:
        from jointid.simulation.synthesis import as_record

        file.write(as_record(logged, simulation, file.joint.force_unit), out)
    if options.json is not None:
        answer = answers.simulation_answer(simulation, file.joint, values, logged)
        answers.write(answer, options.json)


def _simulate_robot(file: File, estimate: Path | None, out: Path | None, options: Options) -> None:
    from jointid import simulate as run
    from jointid.output.json import documents, load_estimate, write
    from jointid.simulation.robots import tracking_errors
    from jointid.simulation.simulated import require_success

    loop, records = file.loop, file.driving(options.record)
    robot = loop.robot
    if estimate is not None:
        loop = replace(loop, robot=load_estimate(estimate, file).require_robot().robot())
    found = require_success(run(loop, records), f"The simulation of {robot.name}")
    peaks = ", ".join(
        f"{name} {peak:.4g} {robot.torque_unit(k)}"
        for k, (name, peak) in enumerate(zip(robot.names, abs(found.torque).max(axis=0), strict=True))
    )
    show(
        f"{len(found.torque)} samples of {found.sample_time:g} s, {found.events} reversals, stops and starts; peak "
        f"torques: {peaks}"
    )
    astray = tracking_errors(records, found)
    for k, off in astray.items():
        show(
            f"{robot.names[k]} does not follow its reference: it gets {off:.3g} {robot.position_unit(k)} off it; check "
            "its controller's gains and limit, and its signs."
        )
    if out is not None:
        file.write(found.records(records), out)
        show(f"Written: {out}")
    if options.json is not None:
        write(documents.robot_simulation_answer(robot, found, astray), options.json)


def reproduce(*, out: Path = Path("jointid-reproduction"), seed: int = 1, quiet: Quiet = False) -> None:
    """Run the paper end to end on its digital twin.

    Its tables show printed, recomputed and newly identified values.

    Args:
        out: folder for the HTML page, the Markdown page and the figures; it is made if it is not there.
        seed: of the noise; the same seed gives the same bytes.
        quiet: say nothing of the progress.
    """
    from jointid.common.charts import png
    from jointid.output.figures import torque_chart
    from jointid.output.report.page import save
    from jointid.paper.reproduce import report_reproduction
    from jointid.paper.reproduce import reproduce as run

    require_room(out)
    with fresh_folder(out, "--out"):
        ready(listen(quiet))
        found = run(seed, listen(quiet))
        written = save(report_reproduction(found, lambda answer: png(torque_chart(answer), 100)), out, "reproduction")
    didim, best = found.first.didim, found.first.best
    for name in ("motor_inertia", "load_inertia", "stiffness"):
        value, std, truth = best.values[name], best[name].stderr or 0.0, found.first.axis.truth[name]
        said = f"{interval(value, 2 * std)} {best[name].unit}, truth {truth:g}, from torque alone"
        show(f"{in_words(name):14} {said}")
    show(
        f"Nelder-Mead took {didim.fit.simulations} simulations, least squares from a grid of starts "
        f"{best.fit.simulations}; "
        f"+10 kg was found as {found.variations('idim')['load_inertia']:.2f} kg by IDIM, "
        f"{found.variations('didim')['load_inertia']:.2f} kg by DIDIM"
    )
    show(f"Written: {', '.join(str(path) for path in written)}")
