"""What is known and what is not: sums before their parts, in sentences."""

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.common.parameters import Parameter, Quantity
from jointid.models.friction import Friction
from jointid.models.joints import FlexibleJoint, RigidJoint
from jointid.uncertainty.covariance import white
from jointid.uncertainty.identifiability import identifiability, sums_of
from studies.healthy import drive

FRICTIONS = (
    Parameter("motor_viscous", "Fv1", Quantity.VISCOUS, lower=0.0),
    Parameter("load_viscous", "Fv2", Quantity.VISCOUS, lower=0.0),
    Parameter("offset", "offset", Quantity.FORCE),
    Parameter("initial_position", "q(0)", Quantity.POSITION),
)
UNITS = {"motor_viscous": "N s/m", "load_viscous": "N s/m", "offset": "N"}
X = np.array([95.0, 106.0, -3.2, 0.0])


def sensitivities(apart: float, rows: int = 4000) -> np.ndarray:
    """Return columns of two frictions that differ by so much, an offset's, and an initial position's."""
    random = np.random.default_rng(0)
    together, difference, first = random.standard_normal((3, rows))
    J = np.column_stack([together + apart * difference, together - apart * difference, np.ones(rows), first])
    J[:, 3] += 0.5 * J[:, 0]
    return J * [0.05, 0.05, 1.0, 1e5]


def residual(rows: int = 4000) -> np.ndarray:
    return 4.0 * np.random.default_rng(1).standard_normal(rows)


def test_of_two_frictions_the_sum_is_to_be_used() -> None:
    J = sensitivities(0.05)
    covariance = white(J, residual())
    found = identifiability(FRICTIONS, UNITS, X, J, covariance)
    (total,) = found.physical
    assert total.combination.formula == "Fv1 + Fv2"
    assert total.value == pytest.approx(201.0)
    together = covariance.matrix[:2, :2]
    assert total.std == pytest.approx(np.sqrt(together.sum()))
    assert len(found.limitations) == 1
    assert found.limitations[0].values["value"] == pytest.approx(total.value)
    assert found.limitations[0].values["std"] == pytest.approx(total.std)


def test_what_must_be_positive_and_is_not_told_from_zero_is_named() -> None:
    J = sensitivities(0.01)
    found = identifiability(FRICTIONS, UNITS, X, J, white(J, residual()))
    told = [one for one in found.limitations if one.code == "not_significant"]
    assert [one.values["parameter"] for one in told] == ["motor_viscous", "load_viscous"]
    free = tuple(replace(p, lower=-np.inf) for p in FRICTIONS)
    unbounded = identifiability(free, UNITS, X, J, white(J, residual()))
    assert not any(one.code == "not_significant" for one in unbounded.limitations)


def test_two_of_different_units_are_to_be_used_together() -> None:
    random = np.random.default_rng(2)
    together, other = random.standard_normal((2, 3000))
    J = np.column_stack([together, 1e-4 * (together + 0.1 * other)])
    parameters = (
        Parameter("coulomb", "Fc", Quantity.FORCE, lower=0.0),
        Parameter("stiffness", "K12", Quantity.STIFFNESS, lower=0.0),
    )
    covariance = white(J, random.standard_normal(3000))
    found = identifiability(parameters, {"coulomb": "N", "stiffness": "N/m"}, np.array([20.0, 2e5]), J, covariance)
    (limitation,) = found.limitations
    together = np.array([1.0, float(limitation.values["weight"])])
    assert limitation.values["std"] == pytest.approx(covariance.std_of(together))
    assert limitation.values["std"] < 0.2 * covariance.std[0]


def test_of_what_has_one_effect_only_the_combination_is_stated() -> None:
    """Whatever the covariance says of a combination that the torque does not contain."""
    J = sensitivities(0.0)
    found = identifiability(FRICTIONS, UNITS, X, J, white(J, residual()))
    assert found.undetermined == ("motor_viscous", "load_viscous")
    assert [known.combination.formula for known in found.physical] == ["Fv1 + Fv2"]
    (limitation,) = found.limitations
    assert limitation.values["std"] == pytest.approx(found.physical[0].std)


def test_combinations_without_an_effect_are_stated_one_by_one() -> None:
    joint = FlexibleJoint("prismatic")
    parameters = [p for p in joint.parameters if p.name.endswith(("viscous", "coulomb")) or p.name == "offset"]
    units = {p.name: joint.unit(p) for p in parameters}
    drawn = np.random.default_rng(4).standard_normal((3, 500))
    columns = dict(zip(("viscous", "coulomb", "offset"), drawn, strict=True))
    J = np.column_stack([columns[p.name.removeprefix("motor_").removeprefix("load_")] for p in parameters])
    found = identifiability(parameters, units, np.ones(5), J, white(J, residual(500)))
    pairs = sorted(one.values["parameters"] for one in found.limitations)
    assert pairs == [["motor_coulomb", "load_coulomb"], ["motor_viscous", "load_viscous"]]


@pytest.mark.slow
def test_a_motion_in_one_direction_determines_no_coulomb_friction() -> None:
    """Beside a constant force, that is; fixing the force determines it."""
    axis = drive(7042, 5.0)
    found = ji.identify(axis.record, axis.loop, checks=False)
    names, truth = ("motor_coulomb", "offset"), axis.truth
    assert [found[name].value for name in names] == [None, None]
    (together,) = [one.values for one in found.known.limitations if one.values.get("parameters") == [*names]]
    assert together["value"] == pytest.approx(sum(truth[name] for name in names), abs=3 * together["std"])
    with pytest.raises(ji.MethodError, match="fix one of them"):
        ji.validate(found, axis.record)
    fixed = {p.name: p.fix(truth[p.name]) for p in axis.loop.joint.parameters if p.name == "offset"}
    coulomb = ji.identify(axis.record, axis.loop, parameters=fixed, checks=False)["motor_coulomb"]
    assert coulomb.value == pytest.approx(truth["motor_coulomb"], abs=3 * (coulomb.stderr or 0.0))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [31014, 70117])
def test_sums_hold_the_effect_of_a_force_on_a_motor_that_rests(seed: int) -> None:
    """By the residual alone the Coulomb friction was 3.8 deviations off, and the viscous one of the second 5.5."""
    axis = drive(seed, 8.0, "white force")
    estimate = ji.identify(axis.record, axis.loop, checks=False)
    for names in (["motor_coulomb", "load_coulomb"], ["motor_viscous", "load_viscous"]):
        error = sum(estimate.values[name] - axis.truth[name] for name in names)
        assert abs(error) <= 2 * estimate.covariance_of(names).std_of(np.ones(2))


def test_the_sums_of_every_joint() -> None:
    """Sums are of both sides, direction by direction; a rigid joint has one side."""
    joint = FlexibleJoint("prismatic", friction=Friction("asymmetric"))
    units = {p.name: joint.unit(p) for p in joint.parameters}
    formulas = [c.formula for c in sums_of(joint.parameters, units)]
    assert formulas == ["ZZ1 + ZZ2", "Fv1+ + Fv2+", "Fc1+ + Fc2+", "Fv1- + Fv2-", "Fc1- + Fc2-"]
    rigid = RigidJoint("prismatic").parameters
    assert not sums_of(rigid, dict.fromkeys((p.name for p in rigid), ""))
    held = tuple(p for p in joint.parameters if p.name != "load_inertia")
    assert "ZZ1 + ZZ2" not in [c.formula for c in sums_of(held, units)]
