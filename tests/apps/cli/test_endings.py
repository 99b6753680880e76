"""A signal that arrives where Python swallows what is raised, as while an object is thrown away."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

PROGRAM = """
import os, sys, time
from jointid.apps.cli import endings

class Thrown:
    def __del__(self):
        os.kill(os.getpid(), int(sys.argv[1]))
        time.sleep(0.01)

endings.listen_to_signals()
try:
    thrown = Thrown()
    del thrown
    time.sleep(20)
except BaseException as error:
    print(type(error).__name__, endings.last_signal())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no process can send itself these signals")
@pytest.mark.parametrize(("number", "name"), [(signal.SIGINT, "KeyboardInterrupt"), (signal.SIGTERM, "EndedError")])
def test_a_signal_in_a_callback_ends_the_program_without_a_traceback(number: signal.Signals, name: str) -> None:
    ran = subprocess.run([sys.executable, "-c", PROGRAM, str(int(number))], capture_output=True, text=True, check=False)
    assert ran.stdout.split() == [name, str(int(number))]
    assert ran.stderr == ""


def test_ctrl_c_while_the_program_is_loaded_is_answered_as_it_is_later() -> None:
    """A module that is loaded with the program takes the signal's exception for a fault of its own."""
    program = """
import builtins, contextlib, signal, sys
from jointid.apps.cli import main

signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever runs the tests may ignore it

whole = builtins.__import__

def interrupted(name, *rest):
    if name == "jointid.apps.cli.app":
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    return whole(name, *rest)

builtins.__import__ = interrupted
sys.argv = ["jointid", "--version"]
main()
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (130, "jointid: Interrupted; no file is left half written.\n")


LOADED = """
import _signal, sys
from jointid.apps.cli import main

_signal.signal(_signal.SIGINT, _signal.default_int_handler)  # whoever runs the tests may ignore it

def note(event, words):
    if event == "import" and not heard:
        heard.append((words[0], _signal.getsignal(_signal.SIGINT).__module__))

heard = []
sys.addaudithook(note)
try:
    main()
finally:
    print(heard)
"""


def test_nothing_is_loaded_before_ctrl_c_ends_the_program() -> None:
    """Python's own answer raises: in the middle of an import that is printed, and ignored."""
    words = [sys.executable, "-c", LOADED, "--version"]
    ran = subprocess.run(words, capture_output=True, text=True, check=False)
    assert ran.stdout.splitlines()[-1] == "[('jointid.apps.cli.app', 'jointid.apps.cli')]"
