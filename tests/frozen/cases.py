"""The cases: each is a seed or a file, and gives the estimate, or another result, that its answer is read from."""

import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import jointid as ji
from tests.edits import Edit, all_channels, changes, declares, has, late_by, law, log, slower, swap

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("JOINTID_DATA", ROOT.parent / "shared" / "data"))
T = 1e-3  # s, of logs and controllers
ENCODER = 2 * math.pi / 2**17
KINDS = ("rigid", "flexible", "geared", "gravity")
NOISES = ("log", "force", "coloured")


def draw(seed: int, kind: str, mode: tuple[float, float] = (12.0, 40.0), duration: float = 4.0) -> SimpleNamespace:
    """Return a random joint under a P-PI cascade, its motion and the sizes of its parts; nothing is simulated yet."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    motor, share, hertz = 10 ** rng.uniform(-2, 1.5), rng.uniform(0.4, 1.6), rng.uniform(*mode)
    rigid = kind in ("rigid", "gravity")
    load = share * motor
    whole, reduced = motor + load, motor * load / (motor + load)
    inner = 2 * math.pi * (0.3 * hertz / math.sqrt(1 + share) if not rigid else rng.uniform(8, 20))
    travel, force = 0.5, 0.5 * whole * rng.uniform(3, 8)
    friction = {"viscous": force * rng.uniform(0.2, 0.6), "coulomb": force * rng.uniform(0.15, 0.5)}
    stiffness = reduced * (2 * math.pi * hertz) ** 2
    values = {"inertia": whole, **friction, "offset": 0.1 * force * rng.uniform(-1, 1)}
    if not rigid:
        spring = {"stiffness": stiffness, "damping": 0.06 * math.sqrt(stiffness * reduced)}
        sides = {f"{side}_{n}": part * v for side, part in (("motor", 0.6), ("load", 0.4)) for n, v in friction.items()}
        values = {"motor_inertia": motor, "load_inertia": load, **sides, **spring, "offset": values["offset"]}
    gear = ji.Transmission(load="revolute", ratio=50.0) if kind == "geared" else None
    ratio = 50.0 if gear else 1.0
    law = ji.controller.Cascade(
        position_gain=inner / 4, velocity_gain=whole * inner / ratio**2, integral_gain=inner / 8, ratio=ratio,
        velocity_filter=ji.controller.FirstOrder(0.5e-3),
    )  # fmt: skip
    gravity = ji.Gravity("link") if kind == "gravity" else None
    if gravity is not None:
        values |= {"gravity_cos": 0.3 * force, "gravity_sin": 0.8 * force}
    made = ji.RigidJoint if rigid else ji.FlexibleJoint
    joint = made("revolute", transmission=gear, gravity=gravity)
    accelerations = rng.uniform(4, 9)
    reference = ji.excitation.trapezoids((0.3, 0.8, 1.4), accelerations, travel, T, 0.1, duration)
    known = ji.excitation.pulses(reference.size, T, height=0.5 * force, width=0.02, every=0.4, seed=seed)
    return SimpleNamespace(
        seed=seed, rng=rng, law=law, declared=law, joint=joint, model=joint, values=values, reference=reference,
        known=known, force=force, forces=[], edits=[], noise=("log", 0.03), stiffness=stiffness,
    )  # fmt: skip


def record(one: SimpleNamespace) -> ji.Record:
    """Return the log of what was drawn, with its noise, forces and edits, and without positions."""
    kind, level = one.noise
    white = level * one.force * one.rng.standard_normal(one.reference.size)
    if kind == "coloured":
        for i in range(1, white.size):
            white[i] = 0.9 * white[i - 1] + 0.44 * white[i]
    acting = sum((f(one) for f in one.forces), np.zeros(white.size)) + (white if kind != "log" else 0.0)
    try:
        logged = ji.simulated_record(
            ji.ClosedLoop(one.joint, one.law), one.reference, one.values, sample_time=T, injected=one.known,
            disturbance=acting, torque_noise=white if kind == "log" else None, encoder_step=ENCODER,
        )  # fmt: skip
    except ji.MethodError as error:
        raise RuntimeError(f"the case cannot be simulated: {error}") from error
    for edit in one.edits:
        logged = edit(logged)
    return logged if getattr(one, "positions", False) else logged.without("motor_position", "load_position")


def healthy(kind: str, noise: str, seed: int) -> ji.Estimate:
    """Identify a joint as it is."""
    one = draw(seed, kind)
    one.noise = (noise, 0.03)
    return ji.identify(record(one), ji.ClosedLoop(one.joint, one.declared))


def follow(logged: ji.Record) -> ji.Record:
    """Give the motor's position as the reference."""
    return logged.with_channels({"reference": replace(logged.reference, values=logged.motor_position.values)})


def push(size: Callable[[Any, Any], Any]) -> Callable[[Any], None]:
    """Add a force along the reference."""
    return lambda one: one.forces.append(lambda one: one.force * size(one.reference, np.gradient(one.reference, T)))


FAULTS: dict[str, Edit] = {
    "position_gain": law(position_gain=1.06), "velocity_gain": law(velocity_gain=0.93),
    "integral_gain": law(integral_gain=1.4), "gain": law(gain=1.04), "law_gain": law(gain=3.0),
    "velocity_filter": has(velocity_filter=ji.controller.FirstOrder(2e-3)), "delay": has(delay=1.5e-3),
    "torque_filter": has(torque_filters=(ji.controller.FirstOrder(1e-3),)),
    "notch": has(torque_filters=(ji.controller.Notch(60.0, 30.0, 0.1),)),
    "velocity_feedforward": has(velocity_feedforward=0.3), "reference_delay": has(reference_delay=2e-3),
    "faster": has(period=T / 4), "interpolation": has(period=T / 4, interpolation="linear"),
    "slow_position_loop": has(position_period=4 * T),
    "no_integral": declares(integral_gain=0.0),
    "swapped_gains": declares(
        position_gain=lambda one: one.law.velocity_gain, velocity_gain=lambda one: one.law.position_gain
    ),
    "integral_time": declares(integral_gain=lambda one: 1 / one.law.integral_gain),
    "limit": lambda one: setattr(one, "law", replace(one.law, limit=2.0 * one.force / one.law.gain)),
    "log_gain": log("torque", lambda x: 1.05 * x), "log_delay": log("torque", late_by(1)),
    "torque_sign": log("torque", np.negative), "reference_sign": log("reference", np.negative),
    "torque_scale": log("torque", lambda x: 9.55 * x), "reference_scale": log("reference", np.degrees),
    "gear_side": log("torque", lambda x: x / 50), "averaged_reference": log("reference", lambda x: np.convolve(
        np.pad(x, (0, 4), mode="edge"), np.full(5, 0.2), "valid")),
    "offset_reference": log("reference", lambda x: x + 0.01 * np.sin(3 * np.arange(x.size) * T)),
    "sample_time": slower(2.0),
    "lost_samples": all_channels(lambda c: replace(c, values=np.delete(c.values, slice(1500, 1506)))),
    "swapped_channels": changes(swap),
    "reference_is_position": changes(follow),
    "injected": changes(lambda r: r.without("injected")),
    "gravity": push(lambda q, v: 0.4 * np.sin(q)), "cogging": push(lambda q, v: 0.15 * np.sin(q / 0.01)),
    "position_force": push(lambda q, v: 0.5 * q), "uneven_friction": push(lambda q, v: -0.6 * q * np.sign(v)),
    "coupled": push(lambda q, v: 0.2 * np.sin(2.2 * np.arange(q.size) * T)),
    "a_push": push(lambda q, v: 0.6 * (np.abs(np.arange(q.size) * T - 2.0) < 0.3)),
}  # fmt: skip
ALONG_POSITIONS = ("sample_time", "reference_is_position", "torque_sign", "lost_samples")


def faulty(name: str, kind: str) -> ji.Estimate:
    """Identify a joint with one fault of loop, log or joint."""
    one = draw(70 + [*FAULTS].index(name), kind)
    one.noise = ("force", 0.02) if one.seed % 2 else ("log", 0.02)
    one.positions = name in ALONG_POSITIONS
    FAULTS[name](one)
    return ji.identify(record(one), ji.ClosedLoop(one.model, one.declared))


MORE: dict[str, Callable[[SimpleNamespace], float]] = {
    "_forwards": lambda one: 1.2, "_backwards": lambda one: 0.8,  # of what the symmetric law has
    "stribeck_force": lambda one: 0.2 * one.force, "stribeck_speed": lambda one: 0.1,
    "presliding_distance": lambda one: 0.01, "friction_per_torque": lambda one: 0.12,
    "viscous_drift": lambda one: -0.03 * one.force, "coulomb_drift": lambda one: -0.02 * one.force,
    "cubic_stiffness": lambda one: 0.5 * one.stiffness / (one.force / one.stiffness) ** 2,
    "gap": lambda one: 0.3 * one.force / one.stiffness, "stiffness_2": lambda one: 1.6 * one.stiffness,
    "stiffness_3": lambda one: 2.5 * one.stiffness, "torque_1": lambda one: 0.3 * one.force,
    "torque_2": lambda one: 0.7 * one.force, "hysteresis_stiffness": lambda one: 0.4 * one.stiffness,
    "hysteresis_torque": lambda one: 0.2 * one.force, "swinging_share": lambda one: 0.3,
    "swinging_stiffness": lambda one: 1.5 * one.stiffness, "swinging_damping": lambda one: 1e-3 * one.stiffness,
}  # fmt: skip
LAWS: dict[str, Callable[[str], Any]] = {"friction": ji.friction.Friction, "spring": ji.spring.Spring}
# Each law has its place in this order, from which its case is drawn.
FRICTIONS = (
    "asymmetric", "asymmetric-load-dependent", "asymmetric-stribeck", "drifting", "load-dependent", "presliding",
    "stribeck", "presliding-load-dependent",
)  # fmt: skip
SPRINGS = "backlash", "cubic", "elastic-load", "hysteretic", "three-piece", "two-piece"


def other_law(part: str, name: str, kind: str, seed: int, known: bool = False) -> ji.Estimate:
    """Identify a joint whose friction or spring has another law than declared, or (`known`) as it is."""
    one = draw(200 + seed, kind)
    one.joint = replace(one.model, **{part: LAWS[part](name)})
    for parameter in one.joint.parameters:
        base = parameter.name.removesuffix("_forwards").removesuffix("_backwards")
        factor = next((f for end, f in MORE.items() if parameter.name.endswith(end)), None)
        if parameter.name not in one.values:
            assert factor is not None, parameter.name
            one.values[parameter.name] = factor(one) * one.values.get(base, 1.0)
    one.values = {p.name: one.values[p.name] for p in one.joint.parameters}
    one.noise = (NOISES[seed % 3], 0.02)
    return ji.identify(record(one), ji.ClosedLoop(one.joint if known else one.model, one.declared))


def untold(seed: int) -> ji.Estimate:
    """Identify a joint as flexible that is as good as rigid, or whose motion does not excite its spring."""
    one = draw(400 + seed, "flexible", mode=(120.0, 400.0) if seed % 2 else (40.0, 80.0))
    one.known, one.noise = 0.0 * one.known, (NOISES[seed % 3], 0.08)
    scale = 0.2 if seed % 2 else 0.1  # slower gains and a slow motion
    one.law = one.declared = replace(one.law, position_gain=6.0, velocity_gain=scale * one.law.velocity_gain,
                                     integral_gain=2.0)  # fmt: skip
    one.reference = ji.excitation.smooth(one.reference, T, 0.15)
    return ji.identify(record(one), ji.ClosedLoop(one.joint, one.declared))


def actuator(output: str, seed: int) -> ji.Estimate:
    """Identify an actuator under a PD law with an undeclared delay: by torque, motor position or commanded torque."""
    one = draw(500 + seed, "flexible" if seed % 2 else "rigid")
    total = one.values.get("inertia") or one.values["motor_inertia"] + one.values["load_inertia"]
    w = 2 * math.pi * 3
    delay = float(one.rng.uniform(1e-3, 4e-3))
    one.declared = ji.controller.PD(position_gain=total * w**2, derivative_gain=1.2 * total * w)
    one.law, one.positions = replace(one.declared, delay=delay), True
    logged = record(one)
    if output == "command":
        logged = logged.without("torque")
    outputs = ("torque",) if output == "torque" else ("motor_position",)
    return ji.identify(logged, ji.ClosedLoop(one.joint, one.declared), ji.DIDIM(free=("delay",), outputs=outputs))


def several(seed: int) -> ji.Estimate:
    """Identify from two records, the second with more inertia; every other seed from windows of one record."""
    kind = KINDS[seed % 2]
    if seed >= 6:
        one = draw(600 + seed, kind, duration=24.0)
        return ji.identify(record(one), ji.ClosedLoop(one.joint, one.declared), windows=6.0)
    one, two = draw(600 + seed, kind), draw(600 + seed, kind)
    name = "inertia" if kind == "rigid" else "load_inertia"
    added = 0.5 * two.values[name]
    two.values[name] += added
    two.rng = np.random.default_rng(seed)
    shared = {"added_inertia": (0.0, added), "free": ("drive_gain",) if seed >= 4 else ()}
    return ji.identify([record(one), record(two)], ji.ClosedLoop(one.joint, one.declared), several=shared)


def arm(count: int, springs: bool, seed: int) -> ji.robots.Robot:
    """Return a chain of bodies about axes that alternate, with rotors, friction and perhaps springs."""
    rng, links, joints = np.random.default_rng([seed, count]), [], []
    for k in range(count):
        mass, centre, size = 6.0 / (1 + k), np.array([0.0, 0.02, 0.12]), np.array([0.15, 0.12, 0.3])
        inertia = np.diag(mass / 12 * (size @ size - size**2)) + mass * (
            centre @ centre * np.eye(3) - np.outer(centre, centre)
        )
        body = np.array([mass, *(mass * centre), *inertia[np.triu_indices(3)]])
        axis = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]][k % 3])
        links.append(ji.robots.Link(f"link{k + 1}", k - 1, axis=axis, origin=np.array([0, 0, 0.3]), inertial=body))
        rotor, viscous, coulomb = rng.uniform(0.4, 1.5), rng.uniform(1, 4), rng.uniform(1, 4)
        spring = None
        if springs:
            stiffness = rotor * (2 * math.pi * rng.uniform(10, 20)) ** 2
            spring = ji.robots.JointSpring(stiffness, 0.005 * stiffness / math.pi, 0.4 * viscous, 0.3 * coulomb)
        joints.append(ji.robots.RobotJoint(f"joint{k + 1}", rotor, viscous, coulomb, 0.1 * coulomb, spring=spring))
    return ji.robots.Robot(tuple(links), tuple(joints), np.array([0.0, 0.0, -9.81]))


def robot(count: int, springs: bool, way: str, seed: int) -> ji.Estimate:
    """Identify a robot by inverse model, closed loop or drive side; or the arm that a URDF describes."""
    rng = np.random.default_rng([700, seed])
    if way == "urdf":
        made = ji.robots.load_robot(DATA.parent / "cases" / "urdf-comment" / "arm.urdf")
        made = replace(made, joints=tuple(replace(j, rotor_inertia=0.3, viscous=1.0, coulomb=1.0) for j in made.joints))
    else:
        made = arm(count, springs, seed)
    n, t = len(made.joints), np.arange(5000) * 2 * T
    begin = np.clip(t / 0.6, 0, 1) ** 3
    phases = rng.uniform(0, 6, (n, 6))
    waves = [sum(np.sin((k + 1) * 0.6 * t + p) / (k + 1) for k, p in enumerate(row)) for row in phases]
    if springs:
        fast = rng.uniform(0, 6, (n, 20))
        for k, row in enumerate(fast):
            waves[k] += 0.06 * sum(
                np.sin(2 * math.pi * (3 + 1.4 * f) * t + p) / (1 + 0.3 * f) for f, p in enumerate(row)
            )
    driven = [ji.Record(reference=ji.Channel(0.5 * begin * w, "rad", 2 * T)) for w in waves]
    sizes = [j.rotor_inertia + sum(6.0 / (1 + i) * (0.3 * (i - k) + 0.15) ** 2 for i in range(k, n) if k % 3)
             for k, j in enumerate(made.joints)]  # fmt: skip
    w = 2 * math.pi * (6.0 if not springs else 4.0)
    laws = tuple(ji.controller.PD(position_gain=s * w**2, derivative_gain=1.8 * s * w) for s in sizes)
    loop = ji.robots.RobotLoop(made, laws)
    logged = ji.simulate(loop, driven).records(driven)
    noisy = [
        r.with_channels({"torque": replace(r.torque, values=r.torque.values + 0.01 * np.std(r.torque.values)
                                           * rng.standard_normal(len(r.torque)))})
        for r in logged if r.torque is not None
    ]  # fmt: skip
    bare = replace(made, joints=tuple(ji.robots.RobotJoint(j.name, j.rotor_inertia, spring=j.spring and replace(
        j.spring, stiffness=1.3 * j.spring.stiffness)) for j in made.joints))  # fmt: skip
    if way == "loop":
        noisy = [r.without("motor_position", "load_position") for r in noisy]
        return ji.identify(noisy, ji.robots.RobotLoop(bare, laws))
    return ji.identify(noisy, bare, ji.DriveSideFit() if springs else ji.IDIM())


def learned(seed: int) -> Any:
    """Learn the controller of a twin of `studies.learned`."""
    from studies.learned import loop_twin

    return ji.learn_controller(loop_twin(seed).record)


def real(name: str) -> Any:
    """Identify a real record in the ways that it allows."""
    folder, way = name.split(" ")
    methods: dict[str, Any] = {
        "didim": ji.DIDIM(),
        "idim": ji.IDIM(),
        "position": ji.DIDIM(outputs=("motor_position",)),
    }
    if folder in ("emps", "pulses"):
        file = ji.load(ROOT / "examples" / "emps" / "joint.toml")
        logged = file.record(DATA / "emps" / ("DATA_EMPS.mat" if folder == "emps" else "DATA_EMPS_PULSES.mat"))
        if way == "drive_side":
            return ji.identify(logged, file.loop.joint, ji.DriveSideFit())
        return ji.learn_controller(logged) if way == "learned" else ji.identify(logged, file.loop, methods[way])
    if folder == "motorbench":
        file = ji.load(ROOT / "examples" / "motorbench" / "joint.toml")
        return file.identify(file.record(DATA / "motorbench" / "MultisineTypeA.mat"))
    file = ji.load(ROOT / "examples" / "kr300" / f"{way}.toml")
    return file.identify(file.record(DATA / "kr300" / "rec_B.mat"))


def shared(case: str) -> Any:
    """Read, or identify, what one of the small inputs beside the records holds; some write their record first."""
    folder, name = case.split("/")
    place = Path("frozen-cases") / folder
    maker = place / "make.py"
    if maker.exists() and not list(place.glob("*.csv")):
        subprocess.run([sys.executable, "make.py"], cwd=place, check=True, capture_output=True)
    path = place / name
    if path.suffix in (".urdf", ".xml"):
        return ji.robots.load_robot(path)
    if path.suffix != ".toml":
        return ji.inspect(path)
    file = ji.load(path)
    return file.identify(file.record())


FILES = (
    "amp-robot/robot.toml", "clock-strings/x.csv", "clock-strings/joint.toml", "coarse-stamps-advice/f32.toml",
    "command-before-profile/joint.toml", "degrees-robot/robot.toml", "drive-off-segment/idim.toml",
    "drive-side-sign/joint.toml", "eccentric-encoder/turn.toml", "effort-nan/nan.toml", "export-armature/robot.toml",
    "export-python-negative-rotor/zero.toml", "false-minimum-sweep/joint.toml", "fast-log/robot_5k.toml",
    "friction-robot/stribeck.toml", "held-default/robot.toml", "held-default/sampled.toml", "hunting-false/joint.toml",
    "identify-refused-free-delay/a03_t.toml", "idim-false-log-gain/f_none.toml", "load-encoder-loop/load.toml",
    "mat-3d/x.mat", "mjcf-freejoint/leg.xml", "mjcf-mesh-base/arm.xml", "npy-rows/x.npy", "npz-json-gz/x.npz",
    "npz-json-gz/x.jsonl", "npz-json-gz/x.csv.gz", "silent-cubic-log-noise/joint.toml",
    "silent-rival-log-gain/joint.toml", "slow-log/joint.toml", "split-time/joint.toml", "tests-in-one-log/joint.toml",
    "trailing-comma-header/x.csv", "two-clocks-crash/stall.toml", "two-clocks-crash/hmi.toml",
    "unsigned-current/log.toml", "urdf-comment/robot.toml", "urdf-comment/twice.toml", "urdf-gripper/robot.toml",
    "urdf-gripper/mimic.toml", "urdf-mimic-missing-parent/arm.urdf", "urdf-negative-friction/arm.urdf",
    "urdf-world-undefined/arm.urdf", "words-column/joint.toml", "wrapped-position/joint.toml", "zero-offset/x.toml",
    "zeroed-midway/joint.toml",
)  # fmt: skip
REAL = (
    "emps didim", "emps idim", "emps position", "emps drive_side", "emps learned", "pulses didim", "pulses idim",
    "motorbench file", *(f"kr300 axis{k}" for k in range(1, 7)), "kr300 robot",
)  # fmt: skip


def every() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield each case: its name and what gives its result."""
    for kind in KINDS:
        for noise in NOISES:
            yield from ((f"healthy {kind} {noise} {s}", partial(healthy, kind, noise, s)) for s in range(5))
    for name in FAULTS:
        yield from ((f"fault {name} {kind}", partial(faulty, name, kind)) for kind in ("geared", "rigid"))
    for part, names, kinds in (("friction", FRICTIONS, ("rigid", "flexible")), ("spring", SPRINGS, ("flexible",))):
        for i, name in enumerate(names):
            for kind in kinds:
                case = partial(other_law, part, name, kind)
                yield f"{part} {name} {kind} undeclared", partial(case, i)
                yield f"{part} {name} {kind} declared", partial(case, 30 + i, known=True)
                if part == "spring":
                    yield f"{part} {name} {kind} undeclared again", partial(case, 60 + i)
    yield from ((f"untold {s}", partial(untold, s)) for s in range(20))
    for s, (count, springs, way) in enumerate([
        *[(2, False, "inverse"), (2, False, "loop"), (2, True, "loop"), (2, True, "drive"), (6, False, "inverse")] * 3,
        (6, False, "loop"), (6, True, "loop"), (0, False, "urdf"), (0, False, "urdf"), (6, True, "drive"),
    ]):  # fmt: skip
        yield f"robot {count} {'flexible' if springs else 'rigid'} {way} {s}", partial(robot, count, springs, way, s)
    for output in ("torque", "position", "command"):
        yield from ((f"actuator {output} {s}", partial(actuator, output, s)) for s in range(5))
    yield from ((f"several {s}", partial(several, s)) for s in range(10))
    yield from ((f"learned {s}", partial(learned, s)) for s in range(6))
    yield from ((f"real {name}", partial(real, name)) for name in REAL)
    yield from ((f"file {name}", partial(shared, name)) for name in FILES)
