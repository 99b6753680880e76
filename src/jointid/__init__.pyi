"""The public names and where they live: the one list, which `__init__.py` loads them by."""

from .common.errors import (
    ExtraError,
    JointFileError,
    JointidError,
    MethodError,
    RecordError,
)
from .config import JointFile, load
from .controller_id.learn import learn_loop
from .controller_id.learned import LearnedLoop
from .diagnostics.check_loop import check_loop
from .diagnostics.compare_estimates import ReportComparison, compare_reports
from .diagnostics.experiment_design import Advice, advise
from .diagnostics.intervals import Intervals, intervals
from .diagnostics.loop_check import LoopCheck
from .diagnostics.method_comparison import Comparison, compare
from .diagnostics.minimum_detectable_change import Detectable, detectable
from .diagnostics.misspecification_tests import LoopTests
from .diagnostics.report_data import Dossier, dossier
from .diagnostics.stiffness_test_design import Revealing, revealing, what_would_tell_more
from .diagnostics.validation import Validation, validate
from .estimation.identify import identify
from .estimation.methods.didim import DIDIM
from .estimation.methods.drive_side import DriveSideFit
from .estimation.methods.flexible import FlexibleDIDIM
from .estimation.methods.idim import IDIM
from .estimation.methods.open_loop import OpenLoopFit
from .estimation.result.estimate import Estimate, IdentifiedJoint
from .estimation.result.params import EstimatedParameter, Params
from .estimation.result.record_fit import RecordFit
from .estimation.several_records.settings import SeveralRecords
from .estimation.streaming.settings import Windowing
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
from .models.transmission import Transmission
from .output.export.export import Export, export, read_estimated, state_space
from .output.export.joint_toml import JointToml
from .output.export.linear import Matlab, StateSpaceJson
from .output.export.mjcf import Mjcf
from .output.export.modelica import Modelica
from .output.export.state_space import StateSpace
from .output.export.urdf import Urdf
from .output.figures.channels import channels_figure
from .output.figures.figures import residual_figure, save, torque_figure
from .output.figures.tuning_figure import tuning_figure
from .output.json import (
    advice_answer,
    comparison_answer,
    drift_answer,
    estimate_answer,
    inspection_answer,
    learned_answer,
    loop_answer,
    read_report,
    revealing_answer,
    simulation_answer,
    tuning_answer,
    validation_answer,
)
from .output.report.report import Report, report_estimate, report_file
from .paper.twin import Twin, twin
from .records.checks.record_checks import check_record
from .records.columns import Column
from .records.drives.drive import Drive
from .records.files.converting import Conversion, convert
from .records.files.inspection import Inspection, inspect
from .records.files.writing import write
from .records.reading.chunks import Log
from .records.reading.read import read
from .records.record import Channel, Injection, InjectionPoint, Record, Tap, Timing, record_of
from .records.signals.excitation import pulses, trapezoids
from .records.signals.filtering import Filtering
from .records.time_base.resampling import Resampling
from .simulation.closed_loop import Initial, Outcome, Simulation, simulate, simulate_many
from .simulation.drive_side import DriveSide
from .simulation.loop_input import ClosedLoop, prepare
from .simulation.open_loop import OpenLoop
from .simulation.synthesis import simulated_record
from .tuning.settings import Tuning
from .tuning.tune import tune
from .tuning.tuned import Tuned

__version__: str
__all__ = [
    "DIDIM",
    "IDIM",
    "PD",
    "PID",
    "Advice",
    "AsymmetricFriction",
    "Cascade",
    "Channel",
    "ClosedLoop",
    "Column",
    "Comparison",
    "Conversion",
    "Counterbalance",
    "Detectable",
    "DigitalFilter",
    "Dossier",
    "Drift",
    "Drive",
    "DriveSide",
    "DriveSideFit",
    "Estimate",
    "EstimatedParameter",
    "Export",
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
    "Inspection",
    "Intervals",
    "JointFile",
    "JointFileError",
    "JointToml",
    "JointidError",
    "LearnedLoop",
    "Log",
    "LoopCheck",
    "LoopTests",
    "Matlab",
    "MethodError",
    "Mjcf",
    "Modelica",
    "MovingAverage",
    "Notch",
    "OpenLoop",
    "OpenLoopFit",
    "Outcome",
    "Parameter",
    "Params",
    "PositionHarmonics",
    "Record",
    "RecordError",
    "RecordFit",
    "Report",
    "ReportComparison",
    "Resampling",
    "Revealing",
    "RigidJoint",
    "SecondOrder",
    "SeveralRecords",
    "Simulation",
    "StateSpace",
    "StateSpaceController",
    "StateSpaceJson",
    "SymmetricFriction",
    "Tap",
    "Timing",
    "Transmission",
    "Tuned",
    "Tuning",
    "Twin",
    "Urdf",
    "Validation",
    "Windowing",
    "advice_answer",
    "advise",
    "channels_figure",
    "check_loop",
    "check_record",
    "compare",
    "compare_reports",
    "comparison_answer",
    "convert",
    "detectable",
    "dossier",
    "drift_answer",
    "estimate_answer",
    "export",
    "frequencies",
    "frequency_response",
    "identify",
    "inspect",
    "inspection_answer",
    "intervals",
    "learn_loop",
    "learned_answer",
    "load",
    "loop_answer",
    "prepare",
    "pulses",
    "read",
    "read_estimated",
    "read_report",
    "record_of",
    "report_estimate",
    "report_file",
    "residual_figure",
    "revealing",
    "revealing_answer",
    "rigid_sums",
    "save",
    "simulate",
    "simulate_many",
    "simulated_record",
    "simulation_answer",
    "state_space",
    "torque_figure",
    "trapezoids",
    "tune",
    "tuning_answer",
    "tuning_figure",
    "twin",
    "validate",
    "validation_answer",
    "what_would_tell_more",
    "write",
]
