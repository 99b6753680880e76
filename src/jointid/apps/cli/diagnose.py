"""`jointid diagnose`: what an estimate is worth, one question a command."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from jointid.apps.cli.console import (
    DEFAULTS,
    FilteringName,
    Flag,
    Inputs,
    Options,
    Several,
    deliver,
    ready,
    show,
)

if TYPE_CHECKING:
    from jointid.config import JointFile


def diagnosis(joint: Path, /, *, options: Options = DEFAULTS) -> None:
    """Find what is wrong with loop, log and model.

    Of each axis: which parameters it determines, what is left of the torque and what that follows, whether the declared
    controller makes the logged torque, and which faults of loop, log and mechanics the record shows.

    Args:
        joint: a joint file, whose joint is identified by didim; or a robot file, which has the table [robot].
        options: those that most commands have.
    """
    from jointid import diagnose
    from jointid.config import JointFile

    file = options.load(joint, options.outputs)
    declared: dict[str, Any] = {"controllers": file.controllers, "feed_forward": file.feed_forward}
    if isinstance(file, JointFile):
        file = options.load_joint(joint, options.outputs, method="didim")
        declared = {"shown": file.declared_numbers}
    record, made = options.identify(file, checks=False, judged=True)
    deliver(diagnose(made, record, **declared), options.json)


def methods(joint: Path, /, *, options: Options = DEFAULTS, filtering: FilteringName | None = None) -> None:
    """Compare the methods of identification on a record.

    Those that the record and the joint file allow.

    Args:
        joint: the joint file (TOML); of its method the settings of didim are used.
        options: those that most commands have.
        filtering: of every method, as for identify.
    """
    _compare(options.load_joint(joint, options.outputs, filtering=filtering), "methods", options)


def springs(joint: Path, /, *, options: Options = DEFAULTS, filtering: FilteringName | None = None) -> None:
    """Find the law of the spring that the record shows.

    Each law is judged by how well it predicts parts of the record that were kept from its fit.

    Args:
        joint: the joint file (TOML); of its method the settings of didim are used.
        options: those that most commands have.
        filtering: of every fit, as for identify.
    """
    _compare(options.load_joint(joint, options.outputs, filtering=filtering, method="didim"), "springs", options)


def friction(joint: Path, /, *, options: Options = DEFAULTS, filtering: FilteringName | None = None) -> None:
    """Find the law of friction that the record shows.

    Each law is judged by how well it predicts parts of the record that were kept from its fit.

    Args:
        joint: the joint file (TOML); of its method the settings of didim are used.
        options: those that most commands have.
        filtering: of every fit, as for identify.
    """
    _compare(options.load_joint(joint, options.outputs, filtering=filtering, method="didim"), "frictions", options)


def _compare(file: JointFile, among: Literal["methods", "springs", "frictions"], options: Options) -> None:
    """Compare methods or laws, and write the result."""
    from jointid import DIDIM, MethodError, compare

    if file.loop is None and among != "methods":  # before the record is read
        raise MethodError(f"{among.capitalize()} are compared in the closed loop; declare the [controller].")
    record, didim = file.record(options.record), file.method
    ready(options.progress)
    known = {"filtering": file.filtering, "parameters": file.parameters, "progress": options.progress}
    model = file.loop or file.joint
    settings = didim if isinstance(didim, DIDIM) else None
    deliver(compare(record, model, among, didim=settings, **known), options.json)  # type: ignore[call-overload]


def intervals(
    joint: Path,
    /,
    *,
    options: Inputs = DEFAULTS,
    of: Several = None,
    bootstrap: Flag = False,
    refit: Flag = False,
) -> None:
    """Check intervals by profiles and bootstraps.

    The joint is identified by didim first.

    Args:
        joint: the joint file (TOML).
        options: those that most commands have.
        of: a parameter, a sum such as "motor_viscous + load_viscous", or compliance; may be given several times.
            Without it and without a bootstrap it is the stiffness, or the inertia of a rigid joint.
        bootstrap: draw over blocks of time, and over stretches of position, direction and speed.
        refit: every draw is a whole fit, which takes minutes; otherwise it is one linear step.
    """
    from jointid import intervals as run
    from jointid.diagnostics.intervals import require_quantities

    file = options.load_joint(joint, method="didim")
    if file.loop is not None:
        require_quantities(of or (), file.loop)
    logged, estimate = options.identify(file, checks=False)
    show(run(estimate, logged, of, bootstrap=bootstrap or refit, refit=refit, progress=options.progress))
