"""`jointid diagnose intervals`: profile likelihoods and bootstraps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from jointid.apps.cli.options import Changes


def intervals(
    joint: Path,
    /,
    *,
    record: Path | None = None,
    changes: Changes = (),
    of: Annotated[list[str] | None, Parameter(negative=())] = None,
    bootstrap: Annotated[bool, Parameter(negative=())] = False,
    refit: Annotated[bool, Parameter(negative=())] = False,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Identify a joint by didim, then follow its criterion along single quantities, or draw bootstraps.

    Args:
        joint: the joint file (TOML).
        record: the record, instead of the one the joint file names.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times.
        of: a parameter, a sum such as "motor_viscous + load_viscous", or compliance; may be given several times.
        bootstrap: draw over blocks of time, and over stretches of position, direction and speed.
        refit: every draw is a whole fit, which takes minutes; otherwise it is one linear step.
        quiet: say nothing of the progress.
    """
    from jointid import intervals as run
    from jointid.apps.cli.console import identified, progress, show
    from jointid.common.errors import MethodError
    from jointid.config import load
    from jointid.diagnostics.intervals import require_quantities

    if not of and not bootstrap:
        raise MethodError("There is nothing to do without --of or --bootstrap; give --of stiffness, say.")
    listener = progress(quiet)
    file = load(joint, changes).override(method="didim")
    if file.loop is not None:
        require_quantities(of or (), file.loop)
    logged, estimate = identified(file, record, listener)
    show(run(estimate, logged, of or (), bootstrap=bootstrap or refit, refit=refit, progress=listener))
