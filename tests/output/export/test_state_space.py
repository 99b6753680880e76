"""The state space, read by SciPy and python-control, against our own simulation."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from scipy.signal import dlsim, lsim

import jointid as ji
from jointid.paper.twin import CONTROLLERS, TABLE_2
from tests.output.export.models import apart, model, pushed, servo, simulated

T = 1e-3
VISCOUS = TABLE_2 | {"motor_coulomb": 0.0, "load_coulomb": 0.0, "offset": 0.0}
JOINT = ji.FlexibleJoint("prismatic")
TORQUE = 50.0 * np.random.default_rng(4).standard_normal(4000)


@pytest.mark.parametrize("delay", [0.0, 0.4e-3, 1e-3, 2.75e-3])
def test_sampled_it_is_our_simulation_whatever_the_delay(delay: float) -> None:
    silent = TORQUE.copy()
    silent[:4] = 0.0  # before its first sample ours acts, the state space's does not
    system = ji.state_space(model(JOINT, VISCOUS)).discretise(T, delay)
    _, found, _ = dlsim(system.scipy(), silent)
    assert apart(found[:, 0], pushed(JOINT, VISCOUS, silent, T, delay)) < 1e-9
    assert system.states[4:] == tuple(f"torque_{i + 1}" for i in range({0.4e-3: 1, 1e-3: 1, 2.75e-3: 3}.get(delay, 0)))


def test_continuous_scipy_gives_the_same_motion() -> None:
    system = ji.state_space(model(JOINT, VISCOUS))
    times = np.arange(TORQUE.size) * T
    _, found, _ = lsim(system.scipy(), TORQUE, times, interp=False)
    assert apart(found[:, 0], pushed(JOINT, VISCOUS, TORQUE, T)) < 1e-9


@pytest.mark.parametrize("made", ["from the file", "from the object"])
def test_python_control_closes_the_loop_with_our_torque(made: str) -> None:
    control = pytest.importorskip("control")
    told = model(JOINT, VISCOUS)
    if made == "from the object":
        system = ji.state_space(told).discretise(T).control()
        assert system.state_labels[:2] == ["motor_position", "motor_velocity"]
        assert system.input_labels == ["torque"]
    else:
        sampled = json.loads(ji.export(told, "state-space").text)["sampled"]
        system = control.ss(*(sampled[letter] for letter in "ABCD"), sampled["period"])
    law, reference = CONTROLLERS["L19"], ji.excitation.trapezoids((0.042, 0.125), 0.83, 0.1, T, duration=3.0)
    state = np.array([reference[0], 0.0, reference[0], 0.0])

    def plant(torque: float) -> float:
        nonlocal state
        state = np.asarray(system.dynamics(0.0, state, np.array([torque])))
        return float(system.output(0.0, state, np.array([torque]))[0])

    assert apart(servo(law, reference, T, plant), simulated(JOINT, law, reference, VISCOUS)) < 1e-9


def test_its_poles_are_the_joint_s() -> None:
    free = ji.FlexibleJoint.frequencies(TABLE_2)
    poles = np.linalg.eigvals(ji.state_space(model(JOINT, TABLE_2)).A)
    assert max(abs(poles)) / (2 * np.pi) == pytest.approx(free["free_free"], rel=1e-3)


def test_on_the_other_side_of_a_transmission_the_motion_is_the_same() -> None:
    gear = ji.Transmission(load="revolute", ratio=80.0, sign=-1)
    joint = ji.FlexibleJoint("revolute", transmission=gear)
    told = model(joint, VISCOUS)
    load, motor = (ji.state_space(told, side=side).discretise(T) for side in ("load", "motor"))
    _, there, _ = dlsim(motor.scipy(), TORQUE)
    _, here, _ = dlsim(load.scipy(), -80.0 * TORQUE)
    assert apart(-80.0 * here[:, 0], there[:, 0]) < 1e-9
    document = json.loads(ji.export(told, "state-space").text)
    assert (document["side"], document["motor_torque_to_input"]) == ("load", -80.0)
    with pytest.raises(ji.MethodError):
        ji.state_space(model(JOINT, VISCOUS), side="motor")


def test_a_counterbalance_is_a_rate_and_the_file_says_what_is_lost() -> None:
    document = json.loads(ji.export(model(JOINT, TABLE_2), "state-space").text)
    lost = " ".join(document["lost"])
    for words in ("Coulomb friction of the motor, 10.000 N", "of the load, 10.400 N", "a constant force of -3.1600 N"):
        assert words in lost
    held = ji.Gravity("constant", ji.spring.Counterbalance(rate=50.0))
    weighing = ji.RigidJoint("prismatic", gravity=held)
    values = {"inertia": 2.0, "viscous": 3.0, "coulomb": 0.0, "offset": 0.0}
    values |= {"gravity_constant": 9.0, "counterbalance_rate": 50.0}
    system = ji.state_space(model(weighing, values))
    assert system.A[1, 0] == 25.0  # what carries more the further it goes pushes away
    flexible = TABLE_2 | {"offset": 0.0, "gravity_constant": 9.0, "counterbalance_rate": 50.0}
    both = ji.state_space(model(ji.FlexibleJoint("prismatic", gravity=held), flexible))
    assert both.A[3, 2] == -(TABLE_2["stiffness"] - 50.0) / TABLE_2["load_inertia"]
    assert any("constant load" in one for one in ji.export(model(weighing, values), "state-space").lost)


def test_the_delay_is_that_of_the_estimate_unless_another_is_asked_for() -> None:
    told = model(JOINT, VISCOUS, delay=1.5e-3)
    asked: list[tuple[dict[str, float], float]] = [({}, 1.5e-3), ({"delay": 0.0}, 0.0)]
    for settings, delay in asked:
        found = json.loads(ji.export(told, "state-space", **settings).text)["sampled"]
        assert found["delay"] == delay
        np.testing.assert_array_equal(found["A"], ji.state_space(told).discretise(T, delay).A)


def test_what_cannot_be_sampled_is_refused() -> None:
    system = ji.state_space(model(JOINT, VISCOUS))
    for period, delay in ((0.0, 0.0), (float("inf"), 0.0), (T, -T), (T, 2.0), (float("nan"), 0.0)):
        with pytest.raises(ji.MethodError):
            system.discretise(period, delay)
    with pytest.raises(ji.MethodError):
        system.discretise(T).discretise(T)
    with pytest.raises(ji.MethodError):
        ji.export(model(JOINT, VISCOUS), "state-space", period=-1.0)
    sampled = json.loads(ji.export(model(JOINT, VISCOUS), "state-space", period=2 * T).text)["sampled"]
    assert sampled["period"] == 2 * T


def test_without_python_control_its_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(ji.ExtraError):
        ji.state_space(model(JOINT, VISCOUS)).control()
