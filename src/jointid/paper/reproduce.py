"""Reproduce the paper, end to end, on its digital twin.

Rigid DIDIM at 5 Hz (Table 1), IDIM (2) and DIDIM (3) of the flexible joint, both again with 10 kg on the load (4, 5),
what changed (6), how far the methods differ (7); the cross test by simulation and the direct validation (Figures 4 and
5); the excitation check; the test of F12. Everything is seeded, so the same seed gives the same numbers.

Choices the paper does not give are those of `twin`: loop L19, a white disturbance inside the loop. The filter is the
correct one, 60 Hz and one sample in six; Nelder-Mead starts from (13) at the paper's 30 Hz.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from jointid import (
    DIDIM,
    IDIM,
    ClosedLoop,
    Estimate,
    Filtering,
    FlexibleDIDIM,
    Record,
    RigidJoint,
    Validation,
    identify,
    validate,
)
from jointid.common.progress import Progress, silent
from jointid.paper.recomputed import DENOMINATORS, Denominator
from jointid.paper.twin import Twin, twin


@dataclass(frozen=True, slots=True, eq=False)
class ReproducedExperiment:
    """One of the paper's two experiments: without the added mass, or with it.

    Attributes:
        axis: the run of the twin.
        idim: from torque and both positions.
        didim: from torque alone, by Nelder-Mead, with the paper's statistics.
        best: from torque alone, by least squares, with the deviations of the output sensitivities.
        idim_simulated: the loop simulated with IDIM's values, against a run with other pulses (Figure 4).
        didim_direct: the loop simulated with DIDIM's values, against its own record (Figure 5).
    """

    axis: Twin
    idim: Estimate
    didim: Estimate
    best: Estimate
    idim_simulated: Validation
    didim_direct: Validation


@dataclass(frozen=True, slots=True, eq=False)
class WithoutDamping:
    """The paper's test of F12: an estimate without it in the model.

    Attributes:
        estimate: with the damping fixed at 0.
        residual_change: of the filtered error, relative.
        shifts: of every other parameter, relative to its value with F12.
    """

    estimate: Estimate
    residual_change: float
    shifts: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Reproduction:
    """Results of the whole reproduction.

    Attributes:
        seed: of the noise.
        rigid: rigid DIDIM of the first experiment.
        first, second: without and with the added mass.
        without_damping: the test of F12, on the first experiment.
    """

    seed: int
    rigid: Estimate
    first: ReproducedExperiment
    second: ReproducedExperiment
    without_damping: WithoutDamping

    def variations(self, method: str) -> dict[str, float]:
        """Return the change of each parameter with the added mass, by "idim" or "didim" (Table 6)."""
        before, after = (getattr(part, method).values for part in (self.first, self.second))
        return {name: after[name] - before[name] for name in before}

    def relative_errors(self, denominator: Denominator) -> tuple[dict[str, float], dict[str, float]]:
        """Return the difference of the methods in both experiments, in percent (Table 7, by either denominator)."""
        assert denominator in DENOMINATORS
        first, second = (
            {
                name: 100 * abs((part.idim.values[name] - value) / getattr(part, denominator.lower()).values[name])
                for name, value in part.didim.values.items()
            }
            for part in (self.first, self.second)
        )
        return first, second


def reproduce(seed: int = 1, progress: Progress = silent) -> Reproduction:
    """Run the paper on its twin; a minute on two cores.

    Args:
        seed: of the noise of the first run; the others follow.
        progress: called with each step.
    """
    axis, heavy = twin(seed=seed), twin(seed=seed + 1, added_mass=True)
    others = twin(seed=seed + 2, pulses_seed=1), twin(seed=seed + 3, added_mass=True, pulses_seed=1)
    progress("Table 1: the rigid joint, below 5 Hz")
    rigid_loop = ClosedLoop(RigidJoint(), axis.loop.controller)
    rigid = identify(keep_torque_only(axis), rigid_loop, DIDIM(), filtering=Filtering(cutoff=5.0))
    first = _reproduce_experiment(axis, others[0], "Tables 2 and 3", progress)
    second = _reproduce_experiment(heavy, others[1], "Tables 4 and 5, with 10 kg on the load", progress)
    progress("The test of F12")
    return Reproduction(seed, rigid, first, second, _remove_damping(axis, first.best))


def keep_torque_only(axis: Twin) -> Record:
    """Return the channels of a run for torque-only identification: torque, reference, and the known pulses."""
    return axis.record.without("motor_position", "load_position")


def _reproduce_experiment(axis: Twin, other: Twin, tables: str, progress: Progress) -> ReproducedExperiment:
    progress(f"{tables}: IDIM")
    idim = identify(axis.record, axis.loop, IDIM())
    progress(f"{tables}: DIDIM by Nelder-Mead")
    didim = identify(keep_torque_only(axis), axis.loop, FlexibleDIDIM.paper())
    progress(f"{tables}: DIDIM by least squares, for its deviations")
    best = identify(keep_torque_only(axis), axis.loop, FlexibleDIDIM())
    # An inverse model's values in a loop that can be simulated.
    filtering = Filtering().resolved(idim.data.sample_time, "flexible")
    simulable = replace(idim.identified, method="didim", loop=axis.loop, filtering=filtering)
    return ReproducedExperiment(
        axis, idim, didim, best, validate(simulable, other.record), validate(didim, axis.record)
    )


def _remove_damping(axis: Twin, best: Estimate) -> WithoutDamping:
    damping = next(p for p in axis.loop.joint.parameters if p.name == "damping")
    estimate = identify(keep_torque_only(axis), axis.loop, FlexibleDIDIM(), parameters={"damping": damping.fixed(0.0)})
    shifts = {name: value / best.values[name] - 1 for name, value in estimate.values.items() if name != "damping"}
    return WithoutDamping(estimate, estimate.fit.filtered_error / best.fit.filtered_error - 1, shifts)
