"""Logs of three actuators, made by MuJoCo: the simulation shares no code with jointid.

python examples/actuator/make.py leg        writes leg.csv into the current folder; without a name all of them

Each drive computes tau = kp (q_des - q) + kd (dq_des - dq) + tau_ff at 1 kHz, with dq the difference of q over the
period, and holds it. Noise is added to the logged torque and position.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

PERIOD = 1e-3  # s, of the drives and of their logs
STEP = 5e-5  # s, of MuJoCo
# As hard as the step allows, so that what sticks does not creep.
HARD = 'solreffriction="-1 -100000" solimpfriction="0.9999 0.9999 0.001 0.5 2"'


@dataclass(frozen=True)
class Actuator:
    """An actuator and its test; numbers are at the joint, in SI units, and named as jointid names them.

    Attributes:
        values: of the joint.
        gains: kp and kd.
        swing: amplitude of q_des, rad, and its lowest and highest frequency, Hz.
        added: amplitude of tau_ff, N m, and its lowest and highest frequency, Hz.
        noise: standard deviation of the logged torque, N m.
        duration: s.
    """

    values: dict[str, float]
    gains: tuple[float, float]
    swing: tuple[float, float, float]
    added: tuple[float, float, float]
    noise: float
    duration: float = 6.0


ACTUATORS = {
    "leg": Actuator(
        {"inertia": 0.032, "viscous": 0.08, "coulomb": 0.35, "gravity_cos": 0.0, "gravity_sin": 2.4, "offset": 0.0},
        (60.0, 1.5), (0.5, 0.3, 3.0), (2.0, 1.0, 30.0), 0.05,
    ),
    "strain-wave": Actuator(
        {
            "motor_inertia": 0.45, "motor_viscous": 8.0, "motor_coulomb": 5.0, "stiffness": 9000.0, "damping": 3.0,
            "load_inertia": 0.2, "load_viscous": 1.0, "load_coulomb": 0.8, "offset": 0.0,
        },
        (1500.0, 60.0), (0.4, 0.2, 2.0), (30.0, 2.0, 90.0), 0.5,
    ),
    "servo": Actuator(
        {
            "motor_inertia": 0.004, "motor_viscous": 0.03, "motor_coulomb": 0.06, "stiffness": 60.0, "damping": 0.1,
            "gap": 0.0175, "load_inertia": 0.002, "load_viscous": 0.004, "load_coulomb": 0.01, "offset": 0.0,
        },
        (12.0, 0.4), (0.5, 0.3, 3.0), (0.6, 1.0, 60.0), 0.01,
    ),
}  # fmt: skip


def multisine(amplitude: float, lowest: float, highest: float, time: np.ndarray, seed: int) -> np.ndarray:
    """Return a sum of sines of random phase whose largest value is the amplitude."""
    rng = np.random.default_rng(seed)
    frequencies = np.geomspace(lowest, highest, 24)
    phases = rng.uniform(0.0, 2.0 * math.pi, frequencies.size)
    wave = np.sin(2.0 * math.pi * frequencies * time[:, np.newaxis] + phases).sum(axis=1)
    return amplitude * wave / np.abs(wave).max()


def model(values: dict[str, float]) -> mujoco.MjModel:
    """Return an actuator in MuJoCo: a pendulum, or motor and load with a tendon as the spring between."""

    def body(name: str, prefix: str, inertia: float, moment: float = 0.0) -> str:
        centre = 0.05  # m below the axis; of the moment in kg m that gives the mass
        mass, about = (moment / centre, inertia - moment * centre) if moment else (1.0, inertia)
        return (
            f'<body name="{name}"><inertial mass="{mass}" pos="0 0 {-centre * bool(moment)!r}" '
            f'diaginertia="{about!r} {about!r} {about!r}"/><joint name="{name}" axis="0 1 0" '
            f'damping="{values[f"{prefix}viscous"]!r}" frictionloss="{values[f"{prefix}coulomb"]!r}" {HARD}/></body>'
        )

    spring = ""
    if "stiffness" in values:
        gap = values.get("gap", 0.0)
        bodies = body("motor", "motor_", values["motor_inertia"]) + body("load", "load_", values["load_inertia"])
        spring = (
            f'<tendon><fixed stiffness="{values["stiffness"]!r}" damping="{values["damping"]!r}" '
            f'springlength="{-gap / 2!r} {gap / 2!r}"><joint joint="load" coef="1"/><joint joint="motor" coef="-1"/>'
            "</fixed></tendon>"
        )
    else:
        bodies = body("motor", "", values["inertia"], values["gravity_sin"] / 9.81)
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81" timestep="{STEP!r}" integrator="implicitfast"/>'
        f"<worldbody>{bodies}</worldbody>{spring}"
        '<actuator><motor joint="motor"/></actuator></mujoco>'
    )


def commands(actuator: Actuator, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return time, q_des, dq_des and tau_ff of an actuator's test, (samples,) each."""
    time = PERIOD * np.arange(round(actuator.duration / PERIOD))
    begin = np.minimum(time / 0.5, 1.0)  # at rest at first
    wanted = begin * multisine(*actuator.swing, time, seed)
    return time, wanted, np.gradient(wanted, PERIOD), begin * multisine(*actuator.added, time, seed + 1)


def make(name: str, target: Path, seed: int = 1) -> None:
    """Simulate the log of an actuator, and write it to a file."""
    actuator = ACTUATORS[name]
    time, wanted, rate, added = commands(actuator, seed)
    (kp, kd), gap = actuator.gains, actuator.values.get("gap", 0.0)
    compiled = model(actuator.values)
    data = mujoco.MjData(compiled)
    torque, position = np.empty_like(time), np.empty_like(time)
    before = 0.0
    for k in range(time.size):
        position[k] = data.qpos[0]
        velocity, before = (position[k] - before) / PERIOD, position[k]
        torque[k] = data.ctrl[0] = kp * (wanted[k] - position[k]) + kd * (rate[k] - velocity) + added[k]
        for _ in range(round(PERIOD / STEP)):
            if gap:  # nothing damps within the play, and a tendon's damper acts everywhere
                apart = abs(data.qpos[1] - data.qpos[0])
                compiled.tendon_damping[0] = actuator.values["damping"] if apart > gap / 2 else 0.0
            mujoco.mj_step(compiled, data)
    rng = np.random.default_rng(seed + 2)
    torque = torque + actuator.noise * rng.standard_normal(time.size)
    position = position + 1e-5 * rng.standard_normal(time.size)
    columns = {
        "t [s]": time, "q_des [rad]": wanted, "dq_des [rad/s]": rate, "tau_ff [N m]": added, "q [rad]": position,
        "tau [N m]": torque,
    }  # fmt: skip
    np.savetxt(
        target,
        np.column_stack(list(columns.values())),
        fmt="%.9g",
        delimiter=",",
        header=",".join(columns),
        comments="",
    )


if __name__ == "__main__":
    for name in sys.argv[1:] or ACTUATORS:
        make(name, Path(f"{name}.csv"))
        print(f"Written: {name}.csv")  # noqa: T201
