"""The public names and where they live: the one list, which `__init__.py` loads them by."""

from .common.errors import ExtraError, JointFileError, JointidError, MethodError, RecordError
from .common.transmission import Transmission
from .config import JointFile, load
from .config.robot_file import RobotFile
from .config.robot_model import load_robot
from .controller_id.learn import learn_controller
from .diagnostics.compare import compare
from .diagnostics.diagnose import diagnose
from .diagnostics.examine_record import examine
from .diagnostics.experiment_design import advise
from .diagnostics.identify import identify
from .diagnostics.intervals import intervals
from .diagnostics.validation import Validation, validate
from .estimation.methods.didim import DIDIM
from .estimation.methods.idim import IDIM
from .estimation.methods.prescribed import DriveSideFit, OpenLoopFit
from .estimation.problems.log_windows import Windowing
from .estimation.problems.several_records import SeveralRecords
from .estimation.result.estimate import Estimate
from .estimation.robots.consistent import consistent_robot
from .estimation.robots.drive_gains import identify_drive_gains
from .estimation.robots.idim import RobotEstimate
from .estimation.robots.payload import identify_payload
from .estimation.robots.torque_estimate import (
    RobotTorqueEstimate,
)
from .models.controllers import PD, PID, Cascade, StateSpaceController, filters
from .models.friction import AsymmetricFriction, SymmetricFriction
from .models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from .models.position_forces import Counterbalance, Gravity
from .models.robots.robot import JointSpring, Link, Robot, RobotJoint
from .output import figures
from .output.export import export, state_space
from .output.json import read_report
from .output.json.documents import to_dict
from .output.report import Report
from .output.report.robots import RobotReport
from .paper.twin import twin
from .planning.design import design_test
from .planning.limits import AxisLimits
from .planning.predict import Noise, planned_record, predict_test
from .planning.robots.design import design_robot_test
from .planning.robots.motions import JointLimits
from .records.chunks import Log
from .records.columns import Column
from .records.drives import Drive
from .records.inspection import inspect
from .records.reading import read
from .records.record import Channel, Record
from .records.signals.filtering import Filtering
from .records.writing import convert, write
from .simulation import excitation
from .simulation.loop_input import prepare
from .simulation.prescribed import DriveSide, OpenLoop
from .simulation.robot_drive_side import RobotDriveSide
from .simulation.robots import RobotLoop, add_feed_forward
from .simulation.synthesis import simulate, simulated_record
from .tuning.proposals import Tuning
from .tuning.tune import tune

__version__: str
__all__ = [
    "DIDIM",
    "IDIM",
    "PD",
    "PID",
    "AsymmetricFriction",
    "AxisLimits",
    "Cascade",
    "Channel",
    "ClosedLoop",
    "Column",
    "Counterbalance",
    "Drive",
    "DriveSide",
    "DriveSideFit",
    "Estimate",
    "ExtraError",
    "Filtering",
    "FlexibleJoint",
    "Gravity",
    "JointFile",
    "JointFileError",
    "JointLimits",
    "JointSpring",
    "JointidError",
    "Link",
    "Log",
    "MethodError",
    "Noise",
    "OpenLoop",
    "OpenLoopFit",
    "Record",
    "RecordError",
    "Report",
    "RigidJoint",
    "Robot",
    "RobotDriveSide",
    "RobotEstimate",
    "RobotFile",
    "RobotJoint",
    "RobotLoop",
    "RobotReport",
    "RobotTorqueEstimate",
    "SeveralRecords",
    "StateSpaceController",
    "SymmetricFriction",
    "Transmission",
    "Tuning",
    "Validation",
    "Windowing",
    "add_feed_forward",
    "advise",
    "compare",
    "consistent_robot",
    "convert",
    "design_robot_test",
    "design_test",
    "diagnose",
    "examine",
    "excitation",
    "export",
    "figures",
    "filters",
    "identify",
    "identify_drive_gains",
    "identify_payload",
    "inspect",
    "intervals",
    "learn_controller",
    "load",
    "load_robot",
    "planned_record",
    "predict_test",
    "prepare",
    "read",
    "read_report",
    "simulate",
    "simulated_record",
    "state_space",
    "to_dict",
    "tune",
    "twin",
    "validate",
    "write",
]
