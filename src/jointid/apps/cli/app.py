"""The program: its commands, and how errors leave it.

Exit code 0 when it worked, 2 for a mistake of the user's (one sentence each) or a result that cannot be written, 1 for
a failure of ours, 3 where `examine` finds something wrong with a record, 130 when interrupted, 143 when ended by
SIGTERM; `--debug` shows the traceback and the warnings of libraries too, and changes no exit code.
"""

from __future__ import annotations

import atexit
import errno
import gc
import os
import signal
import sys
import traceback
import warnings
from functools import partial
from typing import Any, NoReturn

from cyclopts import App, CycloptsError, UnknownOptionError

from jointid import __version__
from jointid.apps import SIGNALLED
from jointid.apps.cli import campaign as campaigns
from jointid.apps.cli import console, endings, streams
from jointid.apps.cli.console import clear_bars, tell
from jointid.apps.cli.data import convert, inspect
from jointid.apps.cli.demo import demo
from jointid.apps.cli.diagnose import advise, diagnosis, friction, intervals, methods, springs
from jointid.apps.cli.identify import examine, identify, learn_controller, payload, tune
from jointid.apps.cli.plan import design
from jointid.apps.cli.results import compare, export, report, validate
from jointid.apps.cli.serve import serve
from jointid.apps.cli.simulate import reproduce, simulate
from jointid.common.errors import JointidError, RecordError
from jointid.common.files import remove_rooms

USERS_MISTAKE, OUR_FAILURE = 2, 1

app = App(
    name="jointid",
    help="Identify a servo-driven joint from motor torque and the commanded reference alone.",
    help_epilogue="Exit code: 0 it worked, 2 a mistake in the command, the joint file or the record (one sentence "
    "each) or a result that cannot be written, 1 a fault of jointid's, 3 examine finds something wrong with a record, "
    "130 interrupted, 143 ended by SIGTERM. --debug, with any command, also prints the traceback and the libraries' "
    "warnings; the exit code stays.",
    version=__version__,
    help_format="plaintext",
    suppress_keyboard_interrupt=False,
)
data = App(name="data", help="Look into files of records, and convert them.", help_format="plaintext")
diagnose = App(name="diagnose", help_format="plaintext")
campaign = App(name="campaign", help="Many joints and many runs, here or on a cluster.", help_format="plaintext")
for parent, commands in (
    (app, (demo, examine, identify, validate, report, compare, advise)),
    (diagnose, (methods, springs, friction, intervals)),
    (app, (diagnose, learn_controller, tune, design, simulate, export, payload, data, campaign, serve, reproduce)),
    (data, (inspect, convert)),
    (campaign, (campaigns.run, campaigns.work, campaigns.status, campaigns.report, campaigns.export)),
):
    for command in commands:
        parent.command(command)
diagnose.default(diagnosis)


def run(arguments: list[str] | None = None, *, signals: bool = False) -> NoReturn:
    """Run the program and exit.

    Args:
        arguments: those of the command line when None.
        signals: whether Ctrl-C and a request to end are this program's to answer.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    console.details = debug = "--debug" in words
    # Matrices here are thousands of rows by ten columns: a second thread only waits for the first, and holds up others.
    for library in ("OPENBLAS", "MKL"):  # each reads this once, when NumPy is loaded
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    # At its end Python would look through all that was loaded for what can be freed, which took 0.3 s of `identify`.
    atexit.register(gc.freeze)
    if arguments is None:
        streams.prepare_outputs()
    warnings.showwarning = partial(_show_warning, debug)
    try:
        if signals:
            endings.listen_to_signals()
        code = _run([word for word in words if word != "--debug"], debug)
    except (KeyboardInterrupt, endings.EndedError):  # once more, while the first was being answered
        code = _end(debug)
    if signals:
        endings.ignore_signals()
    remove_rooms()
    sys.exit(_finish(code))


def _run(words: list[str], debug: bool) -> int:
    try:
        code: int | None = app(words, exit_on_error=False, print_error=False, result_action="return_value")
    except (KeyboardInterrupt, endings.EndedError):
        return _end(debug)
    except Exception as error:
        if endings.last_signal() is not None:  # a library made another exception of it
            return _end(debug)
        if debug and not isinstance(error, CycloptsError):
            traceback.print_exc()
        return _explain(error)
    finally:
        clear_bars()
    return code or 0


def _explain(error: Exception) -> int:
    """Print an error, and return the exit code."""
    if isinstance(error, JointidError):
        return _say(str(error), USERS_MISTAKE)
    if isinstance(error, CycloptsError):
        setting = _setting(error) if isinstance(error, UnknownOptionError) else ""
        return _say(f"{error} {setting}See jointid --help.", USERS_MISTAKE)
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:  # of any path that is opened
        return _explain(RecordError(f"{error.filename} is longer than the name of a file may be; name another file."))
    return _say(
        f"jointid failed, which is a fault of ours ({type(error).__name__}: {error}); please report it with the "
        "output of the same command and --debug.",
        OUR_FAILURE,
    )


def _end(debug: bool) -> int:
    """Print the signal that ends the program, and return the exit code."""
    number = endings.last_signal() or signal.SIGINT
    if debug:
        traceback.print_exc()
    return _say(endings.describe(number), SIGNALLED + number)


def _finish(code: int) -> int:
    """Print what is still held back, and return the exit code; a reader that has gone is no fault."""
    failure = streams.finish_outputs()
    if failure is None or isinstance(failure, BrokenPipeError):
        return code
    reason = (failure.strerror or type(failure).__name__).lower()
    _say(f"The answer could not be printed ({reason}); free space there, or print to another place.", code)
    return code or USERS_MISTAKE


def _show_warning(
    debug: bool, message: Warning | str, category: type[Warning], filename: str, lineno: int, *_: Any
) -> None:
    """Print a warning on the compiler's cache as a sentence; a library's is for who looks for a fault of ours."""
    if category.__name__ == "CacheWarning":  # its module would load the compiler
        tell(f"Warning: {message}")
    elif debug:
        tell(warnings.formatwarning(message, category, filename, lineno).rstrip())


def _setting(error: UnknownOptionError) -> str:
    """Return the sentence on an option that is a key of [method], if the command has --set to reach it; else ""."""
    from jointid.config.schema import MethodTable

    key = (error.token.keyword or "").removeprefix("--").partition("=")[0].replace("-", "_")
    known = key in MethodTable.model_fields and any("--set" in argument.names for argument in error.argument_collection)
    return f"It is a setting of the joint file: give --set method.{key}=VALUE. " if known else ""


def _say(message: str, code: int) -> int:
    clear_bars()
    for line in message.splitlines():
        print(f"jointid: {line}", file=sys.stderr)  # noqa: T201
    return code
