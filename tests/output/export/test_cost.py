"""What it costs that a simulator cannot hold a joint: MuJoCo's torque under the law, against the identified joint's."""

import numpy as np
import pytest

import jointid as ji
from jointid.models.joints import FlexibleJoint
from tests.docs.blocks import ROOT
from tests.output.export.models import apart, model

mujoco = pytest.importorskip("mujoco")
from examples.actuator import make as actuators  # noqa: E402

COSTS = {
    "leg": (0.10, 6.7, 4.9, 29.0),
    "strain-wave": (0.11, 5.4, 9.5, 36.0),
    "servo": (14.0, 15.0, 16.0, 42.0),
}
"""In per cent: the drive's loop around MJCF, the law in MJCF, and the law without the spring in steps of 1 and 5 ms."""


def driven(text: str, name: str) -> np.ndarray:
    """The torque of a model of MuJoCo under the commands of a test: by its own law, or by the drive's around it."""
    actuator = actuators.ACTUATORS[name]
    _, wanted, rate, added = actuators.commands(actuator)
    kp, kd = actuator.gains
    compiled = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(compiled)
    each, before, torque = compiled.opt.timestep / actuators.PERIOD, 0.0, np.empty_like(wanted)
    moved = compiled.joint("motor")
    own = compiled.nu > 1 and "position" in [compiled.actuator(k).name for k in range(compiled.nu)]
    for k in range(wanted.size):
        position = float(data.qpos[moved.qposadr[0]])
        if own:
            data.actuator("position").ctrl, data.actuator("velocity").ctrl = wanted[k], rate[k]
            data.actuator("torque").ctrl = added[k]
        else:
            pull = kp * (wanted[k] - position) + kd * (rate[k] - (position - before) / actuators.PERIOD) + added[k]
            data.actuator("torque").ctrl = pull / compiled.actuator("torque").gear[0]
        before = position
        steps = max(1, round(1 / each)) if k % max(1, round(each)) == 0 else 0
        if steps:
            mujoco.mj_step(compiled, data)
        torque[k] = data.qfrc_actuator[moved.dofadr[0]]  # as the period begins, as the drive logs it
        if steps > 1:
            mujoco.mj_step(compiled, data, steps - 1)
    return torque


@pytest.mark.slow
@pytest.mark.parametrize("name", COSTS)
def test_the_cost_is_mujoco_s(name: str) -> None:
    file, values = ji.load(ROOT / "examples" / "actuator" / f"{name}.toml"), actuators.ACTUATORS[name].values
    _, wanted, rate, added = actuators.commands(actuators.ACTUATORS[name])
    record = ji.simulated_record(
        file.loop, wanted, values, sample_time=actuators.PERIOD, injected=added, reference_velocity=rate
    )
    ours = record.torque.values
    joint = model(file.joint, values)
    whole = joint
    if isinstance(file.joint, FlexibleJoint):
        whole = model(file.joint.rigid, FlexibleJoint.rigid_sums(values) | {"offset": 0.0})
    fine = {"controllers": [file.controller], "timestep": 5e-5}
    texts = (
        ji.export(joint, "mjcf", **fine).text,
        ji.export(joint, "mjcf", control="pd", **fine).text,
        *(ji.export(whole, "mjcf", control="pd", **fine | {"timestep": step}).text for step in (1e-3, 5e-3)),
    )
    found = [100 * apart(driven(text, name), ours) for text in texts]
    assert found == pytest.approx(COSTS[name], rel=0.1, abs=0.05)
