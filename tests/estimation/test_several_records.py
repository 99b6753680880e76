"""Several records in one fit: known masses, a drive's gain, other controllers, and whether two runs agree."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from itertools import count
from typing import Any, Literal

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.estimation.methods import idim
from jointid.estimation.pieces import Records, fill_starts
from jointid.estimation.problems.simulated import Simulated
from jointid.models.friction import Friction
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.paper.twin import Twin, twin
from jointid.records.record import InjectionPoint, Record
from jointid.simulation.excitation import pulses, trapezoids
from jointid.simulation.synthesis import simulated_record
from tests.estimates import beside_tables, identify
from tests.estimation.conftest import CONTROLLER
from tests.estimation.robots.test_several_logs import LOGS, LOOP

RIGID = ClosedLoop(RigidJoint("prismatic"), CONTROLLER)
BRIEF = trapezoids((0.083, 0.125), 0.83, 0.2, 1e-3, duration=8.4)

Noise = Literal["disturbance", "white", "none"]
KILOGRAMS = 10.0
FRICTION = ("motor_viscous", "motor_coulomb", "load_viscous", "load_coulomb")
QUICK = ji.DIDIM(frequency=30.0)


@cache
def twins(noise: Noise) -> Twin:
    """The twin with that noise."""
    return twin(noise=noise)


def heavier(truth: Mapping[str, float]) -> dict[str, float]:
    """The twin with 10 kg on the load, and nothing else changed."""
    return {**truth, "load_inertia": truth["load_inertia"] + KILOGRAMS}


def logged(loop: ClosedLoop, values: Mapping[str, float], noise: Noise = "none", seed: int = 0) -> Record:
    """A run of a twin with the noise of the paper's 8 % on its log, at two of its speeds."""
    random = twins(noise).noise * np.random.default_rng(seed).standard_normal(BRIEF.size)
    known = pulses(BRIEF.size, 1e-3, height=150.0, width=0.02, every=0.4, seed=0)
    record = simulated_record(
        loop, BRIEF, values, sample_time=1e-3, injected=known, torque_noise=random if noise == "white" else None,
        name=f"run {seed}",
    )  # fmt: skip
    return record.without("motor_position", "load_position")


# Noise-free: the truth


@pytest.mark.slow
def test_two_records_under_different_gains() -> None:
    """Each record has its own loop, so its own gains are no more than that."""
    axis = twins("none")
    slower = ClosedLoop(axis.loop.joint, replace(axis.loop.controller, position_gain=120.0, velocity_gain=200.0))  # type: ignore[type-var]
    records = [logged(axis.loop, axis.truth), logged(slower, axis.truth)]
    found = identify(records, [axis.loop, slower], method=QUICK)
    for name, value in found.values.items():
        assert value == pytest.approx(axis.truth[name], rel=1e-4), name
    assert not found.agreement.differs
    with pytest.raises(MethodError, match="gain cannot be distinguished"):
        identify(records, [axis.loop, slower], several={"free": ["drive_gain"]}, method=QUICK)
    wrong = identify(records, axis.loop, method=QUICK)  # the second under the gains of the first
    assert wrong.agreement.differs
    assert "agreement" in [v.name for v in wrong.checks if v.passed is False]


@pytest.mark.slow
def test_a_known_mass_an_own_friction_and_the_gain_of_the_drive() -> None:
    axis, gain = twins("none"), 1.03
    loaded = heavier(axis.truth) | {"motor_coulomb": 11.0, "load_coulomb": 12.0, "load_viscous": 130.0}
    per_log = [{name: value / gain for name, value in truth.items()} for truth in (axis.truth, loaded)]
    shared = {"added_inertia": [0.0, KILOGRAMS], "own": [(), FRICTION], "free": ["drive_gain"]}
    found = identify([logged(axis.loop, values) for values in per_log], axis.loop, several=shared, method=QUICK)
    assert found["drive_gain"].value == pytest.approx(gain, rel=1e-6)
    for name in ("motor_inertia", "load_inertia", "stiffness", "damping", "offset"):
        assert found[name].value == pytest.approx(axis.truth[name], rel=1e-4), name
    for name in FRICTION:
        assert found[f"{name}@1"].value == pytest.approx(axis.truth[name], rel=1e-4), name
        assert found[f"{name}@2"].value == pytest.approx(loaded[name], rel=1e-4), name
    second = found.agreement.parts[1]
    assert second.filtered_error < 1e-6
    # By itself each record has the same inertia on the load: the gain takes it to kilograms, what was added is off.
    assert second.values["load_inertia"] == pytest.approx(axis.truth["load_inertia"])


def test_a_parameter_of_the_first_record_alone_that_the_others_share() -> None:
    """Values, deviations and correlations are under their own names, in whatever order the records bring them."""
    first = {"inertia": 95.0, "viscous": 207.0, "coulomb": 20.0, "offset": 2.0}
    others = first | {"coulomb": 15.0}
    records = [
        simulated_record(
            RIGID, BRIEF, values | {"inertia": values["inertia"] + more}, sample_time=1e-3,
            torque_noise=0.5 * np.random.default_rng(seed).standard_normal(BRIEF.size),
        )
        for seed, (values, more) in enumerate(((first, 0.0), (others, 10.0), (others, 6.0)))
    ]  # fmt: skip
    added = (0.0, 10.0, 6.0)
    found = identify(records, RIGID, several={"added_inertia": added, "own": (("coulomb",), (), ())})
    for name, truth in (others | {"coulomb@1": 20.0}).items():
        assert found[name].value == pytest.approx(truth, abs=0.2), name
        assert abs(found[name].value - truth) <= 4 * found[name].stderr, name
    # The same records with the first of them last: one answer, whose order of parameters is another.
    last = identify(records[::-1], RIGID, several={"added_inertia": added[::-1], "own": ((), (), ("coulomb",))})
    names = {"coulomb": "coulomb", "offset": "offset", "viscous": "viscous", "coulomb@1": "coulomb@3"}

    def together(estimate: ji.Estimate, *pair: str) -> float:
        at = [estimate.free.index(name) for name in pair]
        return float(estimate.correlation[at[0], at[1]])

    for name, other in names.items():
        assert found[name].stderr == pytest.approx(last[other].stderr, rel=0.05), name
        for second, its_other in names.items():
            assert together(found, name, second) == pytest.approx(together(last, other, its_other), abs=0.05)


def test_what_the_method_frees_is_free_for_several_records() -> None:
    late, declared = (replace(RIGID, controller=replace(CONTROLLER, delay=delay)) for delay in (3e-3, 1e-3))
    truth = {"inertia": 95.0, "viscous": 80.0, "coulomb": 20.0, "offset": -3.0}
    records = [
        simulated_record(late, BRIEF, truth, sample_time=1e-3, torque_noise=random.standard_normal(BRIEF.size))
        for random in map(np.random.default_rng, (1, 2))
    ]
    found = identify(records, declared, ji.DIDIM(free=("delay",)))
    assert found["delay"].value == pytest.approx(3e-3, rel=1e-2)
    assert found["viscous"].value == pytest.approx(80.0, rel=0.05)


def test_a_torque_constant_from_a_known_mass() -> None:
    """A torque in ampere: the joint comes in kilograms, and the drive's gain in newtons per ampere."""
    joint = RigidJoint("prismatic", torque_unit="A")
    loop = ClosedLoop(joint, replace(CONTROLLER, gain=1.0))
    truth = {"inertia": 95.0, "viscous": 207.0, "coulomb": 20.0, "offset": -3.0}
    records = [
        simulated_record(loop, BRIEF, {n: v / 35.0 for n, v in values.items()}, sample_time=1e-3)
        for values in (truth, truth | {"inertia": 105.0})
    ]
    with pytest.raises(MethodError, match="per A; free drive_gain"):
        identify(records, loop, several={"added_inertia": [0.0, KILOGRAMS]})
    found = identify(records, loop, several={"added_inertia": [0.0, KILOGRAMS], "free": ["drive_gain"]})
    assert found["drive_gain"].value == pytest.approx(35.0, rel=1e-6)
    assert found["drive_gain"].unit == "N/A"
    assert found["inertia"].value == pytest.approx(95.0, rel=1e-6)
    assert found["inertia"].unit == "kg"


# With noise: what a second record is worth


@pytest.fixture(scope="module")
def noisy() -> ji.Estimate:
    axis = twins("white")
    records = [logged(axis.loop, t, "white", s) for s, t in enumerate((axis.truth, heavier(axis.truth)), 50)]
    return identify(records, axis.loop, several={"added_inertia": [0.0, KILOGRAMS]}, method=QUICK)


def test_a_second_record_narrows_the_intervals(noisy: ji.Estimate) -> None:
    """Each record by itself, and both: about the root of the sum of their informations."""
    parts = noisy.agreement.parts
    for p in (row for row in noisy.rows if row.of_joint):
        alone = [part.std[p.name] for part in parts]
        assert float(p.stderr or 0.0) <= 1.1 * np.sum(np.array(alone) ** -2.0) ** -0.5, p.name
        assert abs(float(p.value or 0.0) - twins("white").truth[p.name]) <= 3 * float(p.stderr or 0.0)
    assert not noisy.agreement.differs


@pytest.mark.parametrize("method", [ji.DIDIM(), ji.IDIM(), ji.DriveSideFit()])
def test_a_record_that_is_much_noisier_does_no_harm(method: Any) -> None:
    truth = {"inertia": 95.0, "viscous": 210.0, "coulomb": 21.0, "offset": 0.0}
    clean: Any = simulated_record(RIGID, BRIEF, truth, sample_time=1e-3)
    torque = replace(clean.torque, stated=False)
    noise = np.random.default_rng(0).standard_normal((2, BRIEF.size)) * [[0.5], [50.0]]
    runs = [replace(clean, torque=replace(torque, values=torque.values + own)) for own in noise]
    model = RIGID if method.simulates == "loop" else RIGID.joint
    found: Any = [identify(one, model, method=method) for one in (runs[0], runs)]
    alone, both = found  # which says, without a controller, that the timing is open
    assert len(both.warnings) == len(alone.warnings) == (method.simulates != "loop")
    for row, other in zip(alone.rows[:3], both.rows[:3], strict=True):
        assert abs(other.value - row.value) < 0.5 * row.stderr and other.stderr < 1.1 * row.stderr


def test_weights_that_still_change_at_the_last_turn_are_not_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    values, turns = {"inertia": 95.0, "viscous": 210.0, "coulomb": 21.0, "offset": 0.0}, count()
    records = [simulated_record(RIGID, reference, values, sample_time=1e-3) for reference in (BRIEF, -BRIEF)]
    for problem, name, settle in ((Records, "weigh", Records.weigh), (Simulated, "reweight", Simulated.reweight)):

        def restless(*given: Any, settle: Any = settle) -> Any:
            return replace(found := settle(*given), sigma=found.sigma * 2.0 ** (next(turns) % 2))

        monkeypatch.setattr(problem, name, restless)
    monkeypatch.setattr(idim, "solve_rows", partial(idim.solve_rows, turns=1))
    cases: Any = ((records, RIGID, None), (records, RIGID.joint, ji.IDIM()), (LOGS[0], LOOP, None))
    for given, model, method in cases:
        found = ji.identify(given, model, method, checks=False)
        assert "search_ended" in found.answer.trust.values["reasons"] and "start" in beside_tables(found)["next"]


def test_what_one_record_refuses_another_may_tell() -> None:
    first, second = fill_starts([{"inertia": 1.0}, {"inertia": 2.0, "coulomb": 3.0}], ["inertia", "coulomb"])
    assert (first["coulomb"], first["inertia"], second["inertia"]) == (3.0, 1.0, 2.0)
    with pytest.raises(MethodError):
        fill_starts([{"inertia": 1.0}], ["inertia", "coulomb"])


# The real axis


@pytest.mark.parametrize("friction", ["symmetric", "asymmetric"])
def test_the_intervals_of_the_two_emps_records_hold_what_their_model_lacks(
    emps: Record, emps_pulses: Record, friction: str
) -> None:
    """Least squares gives 95.4 and 94.1 kg, the solutions by the regressor lie between; every interval holds both."""
    loop = replace(RIGID, joint=RigidJoint("prismatic", friction=Friction(friction)))
    pulses = replace(emps_pulses, injected=replace(emps_pulses.injected, at=InjectionPoint.BEFORE_LIMIT))
    found = identify([emps.without("motor_position"), pulses.without("motor_position")], loop)
    parts = found.agreement.parts
    values, spreads = (np.array([getattr(one, key)["inertia"] for one in parts]) for key in ("values", "std"))
    assert values == pytest.approx([95.4, 94.1], abs=0.1)
    assert abs(values[0] - values[1]) < 2 * np.hypot(*spreads)
    inertia = next(one for one in found.agreement.parameters if one.name == "inertia")
    assert {*found.agreement.names} <= {"offset"}
    assert inertia.between == pytest.approx(0.72, abs=0.1)
    assert abs(values - found["inertia"].value) == pytest.approx(0.0, abs=2 * float(found["inertia"].stderr or 0.0))
    assert found.fit.relative_error <= (0.0479 if friction == "symmetric" else 0.0402)
