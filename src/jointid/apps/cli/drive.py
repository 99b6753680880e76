"""`jointid controller` and `jointid tune`: the drive's law from a record, and what to set in the drive."""

from __future__ import annotations

from pathlib import Path

from jointid.apps.cli.console import DEFAULTS, Options, check_outputs, deliver, show


def controller(joint: Path, /, *, options: Options = DEFAULTS, write: Path | None = None) -> None:
    """Learn the controller from a record that has reference, motor position and torque.

    Args:
        joint: the joint file (TOML); of its [controller], if it has one, the gain is read, and what the
            record does not show of limit and delay.
        options: those that most commands have.
        write: also write the joint file, with the learned [controller], to this file; all else, comments too, stays as
            it is, but for the paths of records, which from another folder lead to the same files.
    """
    from jointid import learn_loop
    from jointid.config import controller_text, save_with_controller

    check_outputs(options.json, write)
    file = options.load(joint)
    learned = learn_loop(
        file.record(options.record),
        gain=1.0 if file.controller is None else getattr(file.controller, "gain", 1.0),
        transmission=file.joint.transmission,
        declared=file.controller,
        progress=options.progress,
    )
    deliver(learned, options.json)
    show(f"\n{controller_text(learned.controller, learned.transmission).rstrip()}")
    if write is not None:
        save_with_controller(file, learned.controller, write)
        show(f"written: {write}")


def tune(
    joint: Path,
    /,
    *,
    options: Options = DEFAULTS,
    gain_margin: float = 2.0,
    phase_margin: float = 45.0,
    modulus: float = 0.5,
    confidence: float = 0.95,
    notch: bool = True,
    false_alarm: float = 0.01,
    power: float = 0.9,
    figure: Path | None = None,
) -> None:
    """Identify a joint by didim, then say how far its loop is from instability, and what to set in the drive.

    Args:
        joint: the joint file (TOML).
        options: those that most commands have.
        gain_margin: that the proposed loop keeps in the worst case, a ratio; 2 is 6 dB.
        phase_margin: likewise, degrees.
        modulus: likewise, the smallest distance of the loop's response from -1; the inverse of the largest sensitivity.
        confidence: with which the interval holds all parameters together.
        notch: whether one may be proposed.
        false_alarm: share of comparisons with a new record that may say a change where there is none.
        power: share that are to say one where it is as large as stated.
        figure: also save the responses of joint and loop, with the interval as a band, as PNG, SVG or PDF.
    """
    from jointid import Tuning
    from jointid import tune as run
    from jointid.diagnostics.check_loop import add_loop_verdict
    from jointid.output.figures.tuning_figure import tuning_figure

    check_outputs(options.json, figures=(figure,))
    settings = Tuning(gain_margin, phase_margin, modulus, confidence, notch, false_alarm, power)
    file = options.load(joint, method="didim")
    record, estimate = options.identify(file)
    if file.tells_of_its_loop:  # margins are of the loop as it is declared
        estimate = add_loop_verdict(estimate, record)
    tuned = run(estimate, settings, drive=file.drive, progress=options.progress)
    deliver(tuned, options.json, (figure, tuning_figure))
