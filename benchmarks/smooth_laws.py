"""How much longer a simulation with smooth laws takes than the plain joint's, and its derivatives, side by side.

    python -m benchmarks.smooth_laws

On a prismatic and a rotary axis of 22 to 24 s, each law large enough to show: of the shortest of several turns.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from benchmarks.__main__ import interleaved
from jointid.simulation.loop_input import prepare
from jointid.simulation.plant import Numbers
from jointid.simulation.simulate import run_loop
from tests.plants import LAWS, prismatic, rotary, with_law
from tests.simulation.differences import sensitivities


def ratio(law: Callable[[], object], plain: Callable[[], object], turns: int) -> float:
    """Return by what factor a law's shortest turn is longer than the plain joint's."""
    times = interleaved({"law": law, "plain": plain}, turns)
    return float(min(times["law"]) / min(times["plain"]))


def main() -> None:
    """Print a row for each law and axis."""
    print("axis, law: simulation, derivatives")
    for make in (prismatic, rotary):
        case = make(1)
        experiment = prepare(case.loop, case.clean)
        plain = partial(run_loop, experiment, Numbers.of_joint(case.loop.joint, case.truth))
        plain_slopes = partial(sensitivities, case.loop, experiment, case.truth, list(case.truth))
        for name in LAWS:
            loop, values = with_law(case, name)
            names = [p.name for p in loop.joint.parameters]
            whole = ratio(partial(run_loop, experiment, Numbers.of_joint(loop.joint, values)), plain, 7)
            slopes = ratio(partial(sensitivities, loop, experiment, values, names), plain_slopes, 3)
            print(f"{make.__name__}, {name}: {whole:.1f}, {slopes:.1f}", flush=True)


if __name__ == "__main__":
    main()
