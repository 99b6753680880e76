"""Common to commands: options, where they print answers and progress, and what they may write."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any, TypeAlias

from cyclopts import Parameter

from jointid.common.errors import JointidError, MethodError, RecordError
from jointid.common.files import require_room
from jointid.common.messages import Detail, Progress, ignore_progress
from jointid.common.text import printable

if TYPE_CHECKING:
    from rich.console import Console

    from jointid import Estimate
    from jointid.common.document import Document, Documented
    from jointid.config import File

Flag: TypeAlias = Annotated[bool, Parameter(negative=())]
Quiet: TypeAlias = Annotated[bool, Parameter(name=["--quiet", "-q"], negative=(), show=False)]
Axis: TypeAlias = Annotated[str | None, Parameter(show=False)]
Changes: TypeAlias = Annotated[tuple[str, ...], Parameter(name="--set", negative=())]
"""Keys of the joint file that are changed before it is checked; every setting can be reached."""

details = False
"""Whether each step of a search is printed, too: with --debug."""

unprinted: list[OSError] = []
"""Why the standard output takes nothing more: it is full, or its reader has gone."""

_BETWEEN = 10.0  # seconds between two lines on one stage
_PATIENCE = 2.0  # seconds after which the simulation is not being loaded but compiled
_BAR, _BESIDE = 12, 24  # characters of a line that are the bar's, and that are not the stage's


def spare(outputs: Iterable[Path | None], *inputs: Path | None) -> None:
    """Refuse outputs that cannot be written, or would replace an input or each other.

    Args:
        outputs: files; None is none.
        inputs: likewise; a folder stands for the files in it.

    Raises:
        RecordError: an output cannot be written, is also an input, or is named twice.
    """
    named = [path for path in inputs if path is not None]
    taken = [*named, *(path for folder in named if folder.is_dir() for path in folder.iterdir())]
    for out in filter(None, outputs):
        if out.is_dir() or not out.absolute().parent.is_dir():
            what = "it is a folder" if out.is_dir() else f"there is no folder {out.parent}"
            raise RecordError(f"{out} cannot be written, because {what}; name another file.")
        require_room(out)
        if any(
            os.path.realpath(out) == os.path.realpath(path) or (out.is_file() and path.is_file() and out.samefile(path))
            for path in taken
        ):
            raise RecordError(f"{out} is read or written already, and would be replaced; name another file.")
        taken.append(out)


def require_kinds(joint: Path | None, *records: Path) -> None:
    """Raise a `RecordError` where a record stands in the place of a joint file, or the reverse, by their suffixes."""
    from jointid.records.formats import FORMATS

    if joint is not None and any(joint.suffix.lower() in entry.suffixes for entry in FORMATS):
        raise RecordError(
            f"{joint} is a record, by its suffix; expected a joint file (.toml): name that first, and the record by "
            f"--record, or write one by jointid inspect {joint} --write joint.toml."
        )
    for record in records:
        if record.suffix.lower() == ".toml":
            raise RecordError(f"{record} is a joint file, by its suffix; expected a record, as log.csv: name that.")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """The options that most commands have.

    Attributes:
        records: the record, instead of the one the joint file names; identify takes several, in one fit.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times.
        axis: of a robot file the name of one joint, which is taken alone, as if no other joint moved.
        again: search again, whatever was found before in the same record, file and version.
        json: also write the answer as JSON to this file.
        quiet: say nothing of the progress.
    """

    records: Annotated[tuple[Path, ...], Parameter(name="--record", negative=())] = ()
    changes: Changes = ()
    axis: Axis = None
    again: Flag = False
    json: Path | None = None
    quiet: Quiet = False

    @property
    def record(self) -> Path | None:
        """The record that is named.

        Raises:
            MethodError: several are.
        """
        if len(self.records) > 1:
            raise MethodError(f"This takes one record; received {len(self.records)} times --record: name one.")
        return self.records[0] if self.records else None

    @property
    def progress(self) -> Progress:
        """The listener to progress."""
        return listen(self.quiet)

    def load(
        self,
        joint: Path,
        *outputs: Path | None,
        alone: bool = False,
        method: str = "",
    ) -> File:
        """Load the joint file or robot file with its changes; see `jointid.config.load`.

        Args:
            joint: the file.
            outputs: what the command writes, beside the JSON.
            alone: whether the work is for a joint.
            method: of a joint, whatever the file says.

        Raises:
            JointFileError: it cannot be loaded.
            MethodError: it is a robot file, and the work is for a joint.
            RecordError: an output is refused, see `spare`, or a record stands for the file.
        """
        from jointid.config import load

        require_kinds(joint, *self.records)
        spare((self.json, *outputs), joint, *self.records)
        file = load(joint, self.changes, axis=self.axis)
        if alone and file.robot is not None:
            raise MethodError(f"This takes one joint, and {joint} is a robot file; name one of its joints by --axis.")
        if method and file.robot is None and file.method.name != method:
            file = load(joint, [*self.changes, f'method={{name="{method}"}}'], axis=self.axis)
        for record in (*self.records, None):
            spare((self.json, *outputs), place_of(file), *file.inputs(record))
        return file

    def identify(
        self, file: File, *, several: bool = False, whole: bool = False, window: float | None = None, **asked: Any
    ) -> tuple[Any, Estimate]:
        """Read the record of a joint or a robot, and identify it as `find` does.

        Args:
            file: as `load` returns it.
            several: whether several records, where they are named or listed, are identified in one fit.
            whole: whether to identify at once, and refuse a record that is too long for it.
            window: seconds of the windows of a log, which is read in chunks.
            asked: further arguments of `find`.

        Returns:
            The record, None of several; and the estimate.

        Raises:
            JointidError: the record cannot be read, or the joint cannot be identified from it.
        """
        from jointid.diagnostics.explain import explain_failure
        from jointid.estimation.identify import windows_of
        from jointid.estimation.result.estimate import IN_WINDOWS

        listed = len(self.records) > 1 or file.source.parts or (file.runs and not self.records)
        together = several and window is None and bool(listed)
        record: Any = None if together else file.record(self.record) if window is None else file.log(self.record)
        if whole and windows_of(record, file.setup, file.method):
            raise MethodError(IN_WINDOWS)
        try:
            return record, self.find(file, record, window, **asked)
        except JointidError as error:
            if together or window is not None or file.robot is not None:
                raise
            raise explain_failure(error, record, file.loop, self.progress, getattr(file.method, "free", ())) from error

    def find(
        self,
        file: File,
        record: Any,
        window: float | None = None,
        *,
        checks: bool = True,
        first: Callable[[Estimate], object] = lambda _: None,
    ) -> Estimate:
        """Return the kept estimate of a record, or identify it and keep the estimate.

        Without a record it is of all that are named. `first` receives the estimate before its checks are made.
        """
        from jointid.diagnostics.identify import UNCHECKED, check_later
        from jointid.estimation.identify import windows_of
        from jointid.output.json import keep, key_of, recall

        paths = self.records or (record is None and file.listed) or [Path(file.record_path())]
        key, progress = key_of(file, paths, self.axis, self.changes, window), self.progress

        def save(one: Estimate) -> Estimate:
            try:
                keep(place_of(file), key, one)
            except RecordError as error:
                progress(f"the estimate is not kept: {error}")
            return one

        apart = record is not None and window is None and not windows_of(record, file.setup, file.method)
        apart = apart and (file.robot is not None or record.torque is not None)
        found = None if self.again else recall(place_of(file), file, key)
        if found is not None and not (checks and UNCHECKED in map(str, found.checks)):
            return found
        if file.robot is None:  # the engine of a robot is another
            ready(progress)
        if record is None:
            found = save(file.identify_together(self.records, progress))
        elif found is None or not apart:
            found = save(file.identify(record, progress, checks=checks and not apart, windows=window))
        if checks and UNCHECKED in map(str, found.checks):
            first(found)
            found = save(check_later(found, record, progress))
        return found


DEFAULTS = Options()


def place_of(file: File) -> Path:
    """Return the path of the kept estimate, beside the joint file or robot file."""
    return file.path.with_suffix(".estimate.json")


def show(line: object) -> None:
    """Print a line; control characters of names in a file are not sent to the terminal."""
    clear_bars()
    put(f"{printable(str(line))}\n", sys.stdout)


def show_result(result: Documented, *, details: bool = False, shown: Sequence[Document] = ()) -> Document:
    """Print a result, in colour on a terminal, optionally with all details; return it as a document.

    Of what was `shown` before its title alone is printed again.
    """
    from jointid.common.document import plain_console

    whole, known = result.to_document(details=details), [block for one in shown for block in one.blocks]
    new = replace(whole, blocks=tuple(block for block in whole.blocks if block not in known))
    if shown:
        show("")
    if sys.stdout.isatty():
        clear_bars()
        new.print(plain_console())
    else:
        show(new.text())
    return whole


def tell(message: str) -> None:
    """Print a line on the standard error."""
    put(f"{printable(message)}\n", sys.stderr)


def put(text: str, stream: IO[str]) -> None:
    """Print at once; where that fails nothing more is printed there, and the command goes on to write its files."""
    try:
        stream.write(text)
        stream.flush()
    except OSError as error:
        if stream is sys.stdout:
            unprinted.append(error)
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class Bars:
    """Draws on the standard error one line that is rewritten: a bar with the stage, and the seconds it has taken.

    What is done leaves nothing there, but for a sentence that is longer than a line.

    Args:
        console: to draw on; one of the standard error when None.
    """

    def __init__(self, console: Console | None = None) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self._console = console or Console(file=sys.stderr)
        parts = BarColumn(_BAR), TimeElapsedColumn(), TextColumn("{task.description}", markup=False)
        self._bar = Progress(*parts, console=self._console, transient=True)
        self._task = self._bar.add_task("", total=None)

    def __call__(self, message: str) -> None:
        """Rewrite the line; print a sentence that is longer above it."""
        from rich.text import Text

        stage = printable(message.brief if isinstance(message, Detail) and not message.pace else message)
        if len(stage) > self._console.width - _BESIDE:
            self._console.print(Text(stage), soft_wrap=True)
        elif stage:
            self._bar.update(self._task, description=stage)
            self._bar.start()

    def clear(self) -> None:
        """Take the line off."""
        self._bar.stop()


_bars = lru_cache(maxsize=1)(Bars)


def listen(quiet: bool) -> Progress:
    """Return the listener to progress: bars on a terminal, else a line for each stage; with --debug every detail."""
    if quiet:
        return ignore_progress
    if details:
        return tell
    if sys.stderr.isatty():
        return _bars()
    stage, told = "", time.monotonic()

    def tell_stage(message: str) -> None:
        nonlocal stage, told
        begun, now = message.brief if isinstance(message, Detail) else message, time.monotonic()
        if begun and begun != stage:
            stage, told = begun, now
            tell(begun)
        elif isinstance(message, Detail) and message.pace and now - told >= _BETWEEN:
            told = now
            tell(message)

    return tell_stage


def clear_bars() -> None:
    """Remove progress bars from the terminal, before other output or the end."""
    if _bars.cache_info().currsize:
        _bars().clear()


def deliver(result: Documented, json: Path | None = None, **printed: Any) -> None:
    """Print a result by `show_result`, and write it as JSON if requested."""
    from jointid.output import json as answers

    show_result(result, **printed)
    if json is not None:
        answers.write(answers.to_dict(result), json)


def ready(listener: Progress, *, derivatives: bool = True) -> None:
    """Load the compiled simulation and its derivatives, and explain a long compilation."""
    from jointid.simulation.warm_up import warm_up

    said = "loading the simulation; the first time on a machine it is compiled, in a minute or two of processor time"
    timer = threading.Timer(_PATIENCE, listener, [said])
    timer.daemon = True
    timer.start()
    try:
        warm_up(derivatives=derivatives)
    finally:
        timer.cancel()
