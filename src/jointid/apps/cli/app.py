"""The program: its commands, and how errors leave it.

Exit code 0 when it worked, 2 for a mistake of the user's (one sentence each), 1 for a failure of ours, 130 when
interrupted. A traceback is shown only with `--debug`.
"""

from __future__ import annotations

import atexit
import gc
import os
import sys

from cyclopts import App, CycloptsError, UnknownOptionError

from jointid import __version__
from jointid.apps.cli.data import convert, inspect
from jointid.apps.cli.diagnose import intervals, loop, methods, sensors
from jointid.apps.cli.drive import controller, tune
from jointid.apps.cli.identify import identify
from jointid.apps.cli.results import compare, export, report, validate
from jointid.apps.cli.serve import serve
from jointid.apps.cli.simulate import demo, reproduce, simulate
from jointid.common.errors import JointidError

USERS_MISTAKE, OUR_FAILURE, INTERRUPTED = 2, 1, 130

app = App(
    name="jointid",
    help="Identify a servo-driven joint from motor torque and the commanded reference alone.",
    version=__version__,
    help_format="plaintext",
    suppress_keyboard_interrupt=False,
)
data = App(name="data", help="Look into files of records, and convert them.", help_format="plaintext")
diagnose = App(name="diagnose", help="Ask what an estimate is worth, one question a command.", help_format="plaintext")
for parent, commands in (
    (app, (demo, identify, validate, report, compare)),
    (diagnose, (methods, intervals, loop, sensors)),
    (app, (diagnose, controller, tune, simulate, export, data, serve, reproduce)),
    (data, (inspect, convert)),
):
    for command in commands:
        parent.command(command)


def main(arguments: list[str] | None = None) -> None:
    """Run the program and exit; `arguments` are those of the command line when None."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    # Matrices here are thousands of rows by ten columns: a second thread only waits for the first, and holds up others.
    for library in ("OPENBLAS", "MKL"):  # each reads this once, when NumPy is loaded
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    # At its end Python would look through all that was loaded for what can be freed, which took 0.3 s of `identify`.
    atexit.register(gc.freeze)
    sys.exit(_run([word for word in words if word != "--debug"], debug))


def _run(words: list[str], debug: bool) -> int:
    try:
        app(words, exit_on_error=False, print_error=False, result_action="return_value")
    except JointidError as error:
        if debug:
            raise
        return _say(str(error), USERS_MISTAKE)
    except CycloptsError as error:
        setting = _setting(error) if isinstance(error, UnknownOptionError) else ""
        return _say(f"{error} {setting}See jointid --help.", USERS_MISTAKE)
    except KeyboardInterrupt:
        return _say("Interrupted; what was written so far is kept.", INTERRUPTED)
    except BrokenPipeError:  # the reader of our output has gone: nothing is left to say
        sys.stderr.close()
        return 0
    except Exception as error:
        if debug:
            raise
        return _say(
            f"jointid failed, which is a fault of ours ({type(error).__name__}: {error}); please report it with the "
            "output of the same command and --debug.",
            OUR_FAILURE,
        )
    return 0


def _setting(error: UnknownOptionError) -> str:
    """Return the sentence on an option that is a key of [method], if the command has --set to reach it; else ""."""
    from jointid.config.schema import MethodTable

    key = (error.token.keyword or "").removeprefix("--").partition("=")[0].replace("-", "_")
    known = key in MethodTable.model_fields and any("--set" in argument.names for argument in error.argument_collection)
    return f"It is a setting of the joint file: give --set method.{key}=VALUE. " if known else ""


def _say(message: str, code: int) -> int:
    for line in message.splitlines():
        print(f"jointid: {line}", file=sys.stderr)  # noqa: T201
    return code
