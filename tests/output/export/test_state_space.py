"""The state space, read by SciPy and python-control, against our own simulation."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.signal import StateSpace, dlsim, lsim

import jointid as ji
from jointid.paper.twin import TABLE_2
from tests.output.export.models import apart, model, pushed

control = pytest.importorskip("control")

T = 1e-3
VISCOUS = TABLE_2 | {"motor_coulomb": 0.0, "load_coulomb": 0.0, "offset": 0.0}
JOINT = ji.FlexibleJoint("prismatic")
TORQUE = 50.0 * np.random.default_rng(4).standard_normal(4000)


def of_file(estimate: ji.Estimate, folder: Path, **settings: Any) -> Any:
    """The content of the .mat file."""
    path = folder / "axis.mat"
    ji.export(estimate, "state-space", **settings).save(path)
    return loadmat(path, simplify_cells=True)


def scipys(system: Any, **timed: float) -> StateSpace:
    return StateSpace(system.A, system.B, system.C, system.D, **timed)


@pytest.mark.parametrize("delay", [0.0, 0.4e-3, 1e-3, 2.75e-3])
def test_sampled_it_is_our_simulation_whatever_the_delay(delay: float) -> None:
    silent = TORQUE.copy()
    silent[:4] = 0.0  # before its first sample ours acts, the state space's does not
    system = ji.state_space(model(JOINT, VISCOUS), period=T, delay=delay)
    _, found, _ = dlsim(scipys(system, dt=T), silent)
    assert apart(found[:, 0], pushed(JOINT, VISCOUS, silent, T, delay)) < 1e-9
    waiting = {0.4e-3: 1, 1e-3: 1, 2.75e-3: 3}.get(delay, 0)
    assert system.state_labels[4:] == [f"torque_{i + 1}" for i in range(waiting)]


def test_continuous_scipy_gives_the_same_motion() -> None:
    system = scipys(ji.state_space(model(JOINT, VISCOUS)))
    _, found, _ = lsim(system, TORQUE, np.arange(TORQUE.size) * T, interp=False)
    assert apart(found[:, 0], pushed(JOINT, VISCOUS, TORQUE, T)) < 1e-9


def test_on_the_other_side_of_a_transmission_the_motion_is_the_same(tmp_path: Path) -> None:
    gear = ji.Transmission(load="revolute", ratio=80.0, sign=-1)
    told = model(ji.FlexibleJoint("revolute", transmission=gear), VISCOUS)
    load, motor = (scipys(ji.state_space(told, side=side, period=T), dt=T) for side in ("load", "motor"))
    _, there, _ = dlsim(motor, TORQUE)
    _, here, _ = dlsim(load, -80.0 * TORQUE)
    assert apart(-80.0 * here[:, 0], there[:, 0]) < 1e-9
    assert of_file(told, tmp_path)["motor_torque_to_input"] == -80.0
    with pytest.raises(ji.MethodError):
        ji.state_space(model(JOINT, VISCOUS), side="motor")


def test_a_counterbalance_is_a_rate_and_what_is_lost_is_said() -> None:
    assert len(ji.export(model(JOINT, TABLE_2), "state-space").lost) == 3
    held = ji.Gravity("constant", ji.spring.Counterbalance(rate=50.0))
    weighing = ji.RigidJoint("prismatic", gravity=held)
    values = {"inertia": 2.0, "viscous": 3.0, "coulomb": 0.0, "offset": 0.0}
    values |= {"gravity_constant": 9.0, "counterbalance_rate": 50.0}
    system = ji.state_space(model(weighing, values))
    assert system.A[1, 0] == 25.0  # what carries more the further it goes pushes away
    flexible = TABLE_2 | {"offset": 0.0, "gravity_constant": 9.0, "counterbalance_rate": 50.0}
    both = ji.state_space(model(ji.FlexibleJoint("prismatic", gravity=held), flexible))
    assert both.A[3, 2] == -(TABLE_2["stiffness"] - 50.0) / TABLE_2["load_inertia"]
    assert ji.export(model(weighing, values), "state-space").lost == ("a constant force of 9.0000 N",)


def test_the_delay_is_that_of_the_estimate_unless_another_is_asked_for(tmp_path: Path) -> None:
    told = model(JOINT, VISCOUS, delay=1.5e-3)
    asked: list[tuple[dict[str, float], float]] = [({}, 1.5e-3), ({"delay": 0.0}, 0.0), ({"period": 2 * T}, 1.5e-3)]
    for settings, delay in asked:
        found, period = of_file(told, tmp_path, **settings)["sampled"], settings.get("period", T)
        assert (found["period"], found["delay"]) == (period, delay)
        np.testing.assert_array_equal(found["A"], ji.state_space(told, period=period, delay=delay).A)


def test_what_cannot_be_sampled_is_refused() -> None:
    told = model(JOINT, VISCOUS)
    for period, delay in ((0.0, 0.0), (float("inf"), 0.0), (T, -T), (T, 2.0), (float("nan"), 0.0)):
        with pytest.raises(ji.MethodError):
            ji.state_space(told, period=period, delay=delay)
    with pytest.raises(ji.MethodError):
        ji.export(told, "state-space", period=-1.0)


def test_without_python_control_its_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(ji.JointidError):
        ji.state_space(model(JOINT, VISCOUS))
