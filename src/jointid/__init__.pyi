"""The public names and where they live: the one list, which `__init__.py` loads them by."""

from .common.errors import ExtraError, JointFileError, JointidError, MethodError, RecordError
from .common.transmission import Transmission
from .config import JointFile, load
from .controller_id.learn import learn_loop
from .diagnostics.check_loop import check_loop
from .diagnostics.compare_estimates import compare_estimates
from .diagnostics.experiment_design import advise
from .diagnostics.intervals import intervals
from .diagnostics.method_comparison import compare_methods
from .diagnostics.stiffness_test_design import design_stiffness_test
from .diagnostics.validation import Validation, validate
from .estimation.identify import identify
from .estimation.methods.didim import DIDIM
from .estimation.methods.drive_side import DriveSideFit
from .estimation.methods.flexible import FlexibleDIDIM
from .estimation.methods.idim import IDIM
from .estimation.methods.open_loop import OpenLoopFit
from .estimation.problems.log_windows import Windowing
from .estimation.problems.several_records import SeveralRecords
from .estimation.result.estimate import Estimate, IdentifiedJoint
from .models.controllers import (
    PD,
    PID,
    Cascade,
    DigitalFilter,
    FirstOrder,
    MovingAverage,
    Notch,
    SecondOrder,
    StateSpaceController,
)
from .models.disturbances import Drift, PositionHarmonics
from .models.friction import AsymmetricFriction, SymmetricFriction
from .models.gravity import Counterbalance, Gravity
from .models.joints import FlexibleJoint, RigidJoint, frequencies, rigid_sums
from .models.linear import frequency_response
from .models.parameters import Parameter
from .output.export.export import export, read_estimated, state_space
from .output.export.joint_toml import JointToml
from .output.export.linear import Matlab, StateSpaceJson
from .output.export.mjcf import Mjcf
from .output.figures.figures import residual_figure, save, torque_figure
from .output.figures.tuning_figure import tuning_figure
from .output.json import read_report
from .output.json.to_dict import to_dict
from .output.report.report import Report, report_estimate, report_file
from .paper.twin import twin
from .records.chunks import Log
from .records.columns import Column
from .records.converting import convert
from .records.drives.drive import Drive
from .records.inspection import inspect
from .records.reading import read
from .records.record import Channel, Injection, InjectionPoint, Record, Tap, Timing
from .records.resampling import Resampling
from .records.signals.excitation import pulses, trapezoids
from .records.signals.filtering import Filtering
from .records.writing import write
from .simulation.closed_loop import Initial, simulate, simulate_many
from .simulation.drive_side import DriveSide
from .simulation.loop_input import ClosedLoop, prepare
from .simulation.open_loop import OpenLoop
from .simulation.synthesis import simulated_record
from .tuning.proposals import Tuning
from .tuning.tune import tune

__version__: str
__all__ = [
    "DIDIM",
    "IDIM",
    "PD",
    "PID",
    "AsymmetricFriction",
    "Cascade",
    "Channel",
    "ClosedLoop",
    "Column",
    "Counterbalance",
    "DigitalFilter",
    "Drift",
    "Drive",
    "DriveSide",
    "DriveSideFit",
    "Estimate",
    "ExtraError",
    "Filtering",
    "FirstOrder",
    "FlexibleDIDIM",
    "FlexibleJoint",
    "Gravity",
    "IdentifiedJoint",
    "Initial",
    "Injection",
    "InjectionPoint",
    "JointFile",
    "JointFileError",
    "JointToml",
    "JointidError",
    "Log",
    "Matlab",
    "MethodError",
    "Mjcf",
    "MovingAverage",
    "Notch",
    "OpenLoop",
    "OpenLoopFit",
    "Parameter",
    "PositionHarmonics",
    "Record",
    "RecordError",
    "Report",
    "Resampling",
    "RigidJoint",
    "SecondOrder",
    "SeveralRecords",
    "StateSpaceController",
    "StateSpaceJson",
    "SymmetricFriction",
    "Tap",
    "Timing",
    "Transmission",
    "Tuning",
    "Validation",
    "Windowing",
    "advise",
    "check_loop",
    "compare_estimates",
    "compare_methods",
    "convert",
    "design_stiffness_test",
    "export",
    "frequencies",
    "frequency_response",
    "identify",
    "inspect",
    "intervals",
    "learn_loop",
    "load",
    "prepare",
    "pulses",
    "read",
    "read_estimated",
    "read_report",
    "report_estimate",
    "report_file",
    "residual_figure",
    "rigid_sums",
    "save",
    "simulate",
    "simulate_many",
    "simulated_record",
    "state_space",
    "to_dict",
    "torque_figure",
    "trapezoids",
    "tune",
    "tuning_figure",
    "twin",
    "validate",
    "write",
]
