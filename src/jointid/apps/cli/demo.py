"""The command `jointid demo`: a simulated axis, robot or fleet."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from jointid.apps.cli.console import Flag, Options, Quiet, listen, ready, show
from jointid.common.document import Document
from jointid.common.errors import MethodError, RecordError
from jointid.common.files import explain, require_room, write_whole
from jointid.common.messages import Progress

if TYPE_CHECKING:
    from jointid.robots import Robot

CAMPAIGN = """\
# Every record of every axis, identified as the joint file says: jointid campaign campaign.toml
name = "fleet of axes"

[fleet]
joint = "joint.toml"                     # one for all; "joints/{joint}.toml" where each has its own
records = "logs/{joint}/{day}.npy"
"""
FIRST_DAY = datetime.date(2026, 10, 1)
_JOINTS, _DAYS = 4, 9
_FALL = 0.1  # of a stiffness
SCATTER = {"stiffness": 0.005, "motor_coulomb": 0.03, "load_coulomb": 0.03, "motor_viscous": 0.03, "load_viscous": 0.03}
"""Standard deviation from day to day, relative to the value."""


def demo(folder: Path | None = None, /, *, robot: Flag = False, fleet: Flag = False, quiet: Quiet = False) -> None:
    """Try all of it on a simulated axis, robot or fleet.

    The axis is the digital twin of the paper's flexible one, and is identified from torque alone, its stiffness too.

    Args:
        folder: where to write, new or empty; without it jointid-demo, jointid-demo-robot or jointid-demo-fleet.
        robot: a robot of two joints instead, one of them flexible, from torques alone.
        fleet: the records of four axes over nine days instead; the stiffness of one axis falls.
        quiet: print no progress.
    """
    if robot and fleet:
        raise MethodError("A demo is of a robot or of a fleet; leave out --robot or --fleet.")
    folder = folder or Path("jointid-demo-robot" if robot else "jointid-demo-fleet" if fleet else "jointid-demo")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise RecordError(f"{folder} is not empty, and a demo might replace what it holds; name another folder.")
    require_room(folder)
    listener = listen(quiet)
    with explain(folder), TemporaryDirectory(prefix=".jointid-", dir=folder.absolute().parent) as room:
        fresh = Path(room)
        listener(f"simulating {'a fleet' if fleet else 'a robot' if robot else 'an axis'}")
        if fleet:
            ready(listener)
            name, said = "campaign.toml", _write_fleet(fresh)
        else:
            name, truth = _write_robot(fresh) if robot else _write_axis(fresh)
            said = _identify(fresh, name, truth, listener)
        folder.mkdir(exist_ok=True)  # it may be the current folder, which cannot be replaced
        for path in fresh.iterdir():
            path.rename(folder / path.name)
    show(said)
    show(f"\nWritten to {folder}: {', '.join(sorted(path.name for path in folder.iterdir()))}")
    if fleet:
        show(f"See what changed, which takes minutes: jointid campaign {folder / name}")
    else:
        show(f"All of it on one page: jointid report {folder / name} --html report.html")
        show(f"Change the {Path(name).stem} file, then: jointid identify {folder / name}")


def _identify(folder: Path, name: str, truth: Any, listener: Progress) -> str:
    """Identify by the file; write answer and figure; return a comparison."""
    from jointid import figures
    from jointid.estimation.result.summary import parameters_table

    listener("identifying it from motor torque and reference alone")
    options = Options(quiet=True)
    estimate = options.identify(options.load(folder / name))[1]
    figures.save(figures.torque(estimate), folder / "torque.png")
    if estimate.robot is not None:
        values = estimate.robot.parameters_of(truth)
        truth = dict(zip(estimate.robot.names, values.tolist(), strict=True))
    return Document(str(estimate.answer), (parameters_table(estimate, details=False, truth=truth),)).text()


def _write_axis(folder: Path) -> tuple[str, Mapping[str, float]]:
    """Write the twin's record and joint file; return name and truth."""
    from jointid import twin, write
    from jointid.paper.twin import JOINT_FILE

    axis = twin(seed=1)
    write(axis.record, folder / "record.csv")
    write_whole(folder / "joint.toml", JOINT_FILE)
    return "joint.toml", axis.truth


def _write_robot(folder: Path) -> tuple[str, Robot]:
    """Write a robot's file and model, and records of a heavier one with friction; return name and robot."""
    import numpy as np

    from jointid import Channel, Record, excitation, simulate
    from jointid.config import load
    from jointid.robots import JointSpring

    for name in ("robot.toml", "robot.xml"):
        write_whole(folder / name, files("jointid.apps.cli").joinpath("demo_robot", name).read_text("utf-8"))
    file = load(folder / "robot.toml")
    links = tuple(replace(link, inertial=1.1 * link.inertial) for link in file.loop.robot.links)
    shoulder, elbow = file.loop.robot.joints
    spring = JointSpring(stiffness=2560.0, damping=2.7, viscous=1.2, coulomb=1.2)
    shoulder = replace(shoulder, rotor_inertia=0.8, viscous=1.8, coulomb=2.8, spring=spring)
    elbow = replace(elbow, rotor_inertia=0.3, viscous=1.2, coulomb=1.5)
    robot = replace(file.loop.robot, links=links, joints=(shoulder, elbow))
    motions = ((0.9, 0.25, 24), (1.2, 0.375, 19))  # rad, Hz of the slowest sine, number of sines, up to above the mode
    driven = [
        Record(reference=Channel(excitation.multisine(8000, 1e-3, size, f, 35.0, lines=n, tilt=1.6), "rad", 1e-3))
        for size, f, n in motions
    ]
    draw, logged = np.random.default_rng(1), []
    for record in simulate(replace(file.loop, robot=robot), driven).records(driven):
        assert record.torque is not None
        values = record.torque.values
        noisy = values + 0.02 * np.std(values) * draw.standard_normal(values.size)
        logged.append(replace(record, torque=replace(record.torque, values=noisy), motor_position=None))
    file.write(logged, folder / "record.csv")
    return "robot.toml", robot


def _write_fleet(folder: Path) -> str:
    """Write the records and files of a fleet of twins.

    Parameters scatter from day to day. The stiffness of the first joint drops in the middle third of the days.
    """
    import numpy as np

    import jointid as ji
    from jointid.paper.twin import CONTROLLERS, JOINT_FILE, TABLE_2

    joint = JOINT_FILE.replace("record.csv", f"logs/axis-001/{FIRST_DAY}.npy")
    names = [f"axis-{number + 1:03}" for number in range(_JOINTS)]
    table = "name,filtering.cutoff,method.frequency\n" + "".join(f"{name},60,30\n" for name in names)
    for file, text in {"campaign.toml": CAMPAIGN, "joint.toml": joint, "fleet.csv": table}.items():
        write_whole(folder / file, text)
    loop = ji.ClosedLoop(ji.FlexibleJoint("prismatic"), CONTROLLERS["L19"])
    reference = ji.excitation.trapezoids((0.042, 0.083, 0.125), 0.83, 0.1, 1e-3, duration=8.0)
    pulses = ji.excitation.pulses(reference.size, 1e-3, height=150.0, width=0.02, every=0.4, seed=0)
    for place, name in enumerate(names):
        draw = np.random.default_rng([1, place])
        own = {name: value * (1 + 0.1 * draw.uniform(-1, 1)) for name, value in TABLE_2.items()}
        begins = int(draw.integers(_DAYS // 3, 2 * _DAYS // 3))
        (folder / "logs" / name).mkdir(parents=True)
        for day in range(_DAYS):
            today = {name: value * (1 + SCATTER.get(name, 0.0) * draw.standard_normal()) for name, value in own.items()}
            today["stiffness"] *= 1 - _FALL * (place == 0 and day >= begins)
            force = 10.0 * draw.standard_normal(reference.size)
            record = ji.simulated_record(
                loop, reference, today, sample_time=1e-3, injected=pulses, disturbance=force, encoder_step=5e-8
            )
            ji.write(record, folder / "logs" / name / f"{FIRST_DAY + datetime.timedelta(days=day)}.npy")
    return "The stiffness of axis-001 falls by a tenth one day."
