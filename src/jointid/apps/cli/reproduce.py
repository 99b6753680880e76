"""`jointid reproduce`: the paper, run end to end on its digital twin."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def reproduce(
    *,
    out: Path = Path("jointid-reproduction"),
    seed: int = 1,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Run the paper end to end on its digital twin and set every table beside its printed and recomputed self.

    Args:
        out: folder for the HTML page, the Markdown page and the figures; it is made if it is not there.
        seed: of the noise; the same seed gives the same bytes.
        quiet: say nothing of the progress.
    """
    from jointid.apps.cli.console import make_folder, progress, ready, show
    from jointid.output.figures import torque_png
    from jointid.output.report.page import require_extra, save
    from jointid.paper.reproduce import reproduce as run
    from jointid.paper.reproduce import reproduction_document

    require_extra(plots=False)
    make_folder(out)
    listener = progress(quiet)
    ready(listener)
    found = run(seed, listener)
    written = save(reproduction_document(found, torque_png), out, "reproduction")
    didim, best = found.first.didim, found.first.best
    for name in ("motor_inertia", "load_inertia", "stiffness"):
        value, std, truth = best.values[name], best[name].stderr or 0.0, found.first.axis.truth[name]
        show(
            f"{best[name].symbol:4} {value:.5g} +- {2 * std:.2g} {best[name].unit}, truth {truth:g}, from torque alone"
        )
    show(
        f"Nelder-Mead took {didim.fit.simulations} simulations, least squares from a grid of starts "
        f"{best.fit.simulations}; "
        f"+10 kg was found as {found.variations('idim')['load_inertia']:.2f} kg by IDIM, "
        f"{found.variations('didim')['load_inertia']:.2f} kg by DIDIM"
    )
    show(f"Written: {', '.join(str(path) for path in written)}")
