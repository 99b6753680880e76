"""The program: its commands and errors, with exit codes of docs/commands.md."""

from __future__ import annotations

import _thread
import atexit
import gc
import io
import os
import platform
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from difflib import get_close_matches
from importlib import metadata
from typing import Any, NoReturn

from cyclopts import App, CycloptsError, Group, Parameter

from jointid import __version__
from jointid.apps.cli import console
from jointid.apps.cli.campaign import campaign
from jointid.apps.cli.console import clear_bars, put
from jointid.apps.cli.demo import demo
from jointid.apps.cli.identify import identify, learn_controller, payload, tune
from jointid.apps.cli.inspection import diagnose, inspect
from jointid.apps.cli.results import compare, export, report, validate
from jointid.apps.cli.serve import serve
from jointid.apps.cli.simulate import design, reproduce, simulate
from jointid.common.errors import JointidError

USERS_MISTAKE, OUR_FAILURE = 2, 1
_SIGNALLED = 128  # the exit code is this plus the signal's number
_INTERRUPTED = "Interrupted; no file is left half written."
_ENDING = "Further options, as --quiet, and exit codes: docs/commands.md"


def _versions() -> str:
    """Return the versions of this package, Python and the numerical packages."""
    known = (f"{name} {metadata.version(name)}" for name in ("numpy", "scipy", "numba"))
    return "\n".join((f"jointid {__version__}", f"Python {platform.python_version()}", *known))


app = App(
    name="jointid",
    help="Identify a servo-driven joint from motor torque and the commanded reference alone.",
    help_epilogue=f"Begin with: jointid demo\n\n{_ENDING}",
    group_commands=Group("Options", sort_key=9),
    version=_versions,
    help_format="markdown",
    version_format="plaintext",
    default_parameter=Parameter(show_default=lambda value: value or None),  # no word of what is off or empty
    suppress_keyboard_interrupt=False,
)

_GROUPS: Mapping[str, tuple[Callable[..., Any], ...]] = {
    "Start": (demo, inspect, serve, reproduce),
    "Identify": (identify, learn_controller, report, payload),
    "Ask what the result is worth": (diagnose, validate, compare),
    "Use the result": (tune, design, simulate, export),
    "Many": (campaign,),
}
for _place, (_name, _commands) in enumerate(_GROUPS.items()):
    _group = Group(_name, sort_key=_place)
    for _order, _command in enumerate(_commands):
        app.command(_command, group=_group, sort_key=_order, help_epilogue=_ENDING)


def run(arguments: list[str] | None = None, *, signals: bool = False) -> NoReturn:
    """Run the program and exit.

    Args:
        arguments: None takes those of the command line.
        signals: whether to handle SIGINT and SIGTERM, and to hide libraries' warnings without --debug.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    console.details = debug = "--debug" in words
    # Matrices here have thousands of rows and some ten columns: further threads only wait, and delay others.
    for library in ("OPENBLAS", "MKL"):  # each reads this once, when NumPy is loaded
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    atexit.register(gc.freeze)  # skip the garbage collection at exit, which took 0.3 s of `identify`
    _prepare_outputs()
    try:
        if signals:
            warnings.simplefilter("default" if debug else "ignore")
            sys.unraisablehook = _interrupt_again
            if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # a shell's background job ignores it
                signal.signal(signal.SIGINT, signal.default_int_handler)
            signal.signal(signal.SIGTERM, _leave)
        code = _finish(_run([word for word in words if word != "--debug"], debug))
    except KeyboardInterrupt:  # a second one, while the first was handled
        code = _say("Interrupted.", _SIGNALLED + signal.SIGINT)
    if signals:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(code)


def _interrupt_again(swallowed: sys.UnraisableHookArgs) -> None:
    """Repeat an interrupt that a callback of Python, as a destructor, swallowed."""
    if issubclass(swallowed.exc_type, KeyboardInterrupt):
        threading.Timer(0.01, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(swallowed)


def _leave(number: int, _: object) -> NoReturn:
    """Say so and exit at once; a library's callback may swallow an exception."""
    with suppress(OSError):
        os.write(2, f"jointid: {_INTERRUPTED}\n".encode())
    os._exit(_SIGNALLED + number)


def _prepare_outputs() -> None:
    """Replace unprintable characters, and closed outputs by the null device."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # it was closed before the program began
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115 - until the program ends
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _run(words: list[str], debug: bool) -> int:
    """Run a command, print its error, and return the exit code."""
    try:
        return int(app(words, exit_on_error=False, print_error=False, result_action="return_value") or 0)
    except (Exception, KeyboardInterrupt) as error:
        if debug and not isinstance(error, CycloptsError):
            traceback.print_exc()
        return _say(*_explain(error))
    finally:
        clear_bars()


def _explain(error: BaseException) -> tuple[str, int]:
    """Return the sentence of an error, and the exit code."""
    if isinstance(error, KeyboardInterrupt):
        return _INTERRUPTED, _SIGNALLED + signal.SIGINT
    if isinstance(error, JointidError):
        return str(error), USERS_MISTAKE
    if isinstance(error, CycloptsError):
        options = [name for one in getattr(error, "argument_collection", ()) for name in one.names]
        hint = "A key of the joint file is given by --set. " if "--set" in options else ""
        words, chain = error.unused_tokens or [""], " ".join(("jointid", *(error.command_chain or ())))
        known, said = [one for one in app if not one.startswith("-")], f"{error} {hint}See {chain} --help."
        if chain == "jointid" and "." in words[0]:
            said = f"For this file: jointid {'identify' if words[0].endswith('.toml') else 'inspect'} {words[0]}."
        elif chain == "jointid" and (meant := [*({*words} & {*known}), *get_close_matches(words[0], known)]):
            said = f'Did you mean {meant[0]}? See jointid {meant[0]} --help. There is no command "{words[0]}".'
        return said, USERS_MISTAKE
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename} cannot be used ({error.strerror}); name another file.", USERS_MISTAKE
    return (
        f"jointid failed, which is a fault of ours ({type(error).__name__}: {error}); please report it with the "
        "output of the same command and --debug, and that of jointid --version.",
        OUR_FAILURE,
    )


def _finish(code: int) -> int:
    """Flush the output, and return the exit code; ignore broken pipes."""
    put("", sys.stdout)
    failures = [error for error in console.unprinted if not isinstance(error, BrokenPipeError)]
    said = f"The answer could not be printed ({failures[0]}); print to another place." if failures else ""
    return _say(said, code or USERS_MISTAKE) if failures else code


def _say(message: str, code: int) -> int:
    clear_bars()
    for line in message.splitlines():
        put(f"jointid: {line}\n", sys.stderr)
    return code
