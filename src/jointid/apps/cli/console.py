"""Common to commands: options, output, progress and permitted files."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any, TypeAlias

from cyclopts import Parameter

from jointid.common.errors import JointidError, MethodError, RecordError
from jointid.common.files import require_room, write_whole
from jointid.common.messages import Detail, Progress, ignore_progress
from jointid.common.text import printable

if TYPE_CHECKING:
    from rich.console import Console

    from jointid import Estimate
    from jointid.common.document import Documented
    from jointid.config import File

Flag: TypeAlias = Annotated[bool, Parameter(negative=())]
Quiet: TypeAlias = Annotated[bool, Parameter(name=["--quiet", "-q"], negative=(), show=False)]
Axis: TypeAlias = Annotated[str | None, Parameter(show=False)]
Changes: TypeAlias = Annotated[tuple[str, ...], Parameter(name="--set", negative=())]
"""Changes to any keys of the joint file, applied before it is checked."""

details = False
"""Whether to print each step of a search (--debug)."""

unprinted: list[OSError] = []
"""Errors of the standard output: a full disk, or a closed pipe."""

_BETWEEN = 10.0  # seconds between two lines on one stage
_PATIENCE = 2.0  # seconds of loading after which the simulation must be compiling
_BAR, _BESIDE = 12, 24  # width of the bar, and of all columns but the stage


def spare(outputs: Iterable[Path | None], *inputs: Path | None) -> None:
    """Refuse outputs that cannot be written or would replace another file.

    Args:
        outputs: files; None is ignored.
        inputs: likewise; a folder includes the files in it.

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
    """Refuse a record in place of a joint file, or the reverse."""
    from jointid.records.formats import FORMATS

    if joint is not None and any(joint.suffix.lower() in entry.suffixes for entry in FORMATS):
        raise RecordError(
            f"{joint} is a record, by its suffix; expected a joint file (.toml): name that first, and the record by "
            f"--record, or write one by jointid inspect {joint} --write joint.toml."
        )
    if tables := [one for one in records if one.suffix.lower() == ".toml"]:
        raise RecordError(f"{tables[0]} is a joint file, by its suffix; expected a record, as log.csv: name that.")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """Options of most commands.

    Attributes:
        records: the record, instead of the one the joint file names; identify takes several, in one fit.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times.
        axis: name of one joint of a robot file, which is taken alone, with the others at rest.
        again: search again, even if an estimate of the same record, file and version is kept.
        json: also write the answer as JSON to this file.
        quiet: print no progress.
    """

    records: Annotated[tuple[Path, ...], Parameter(name="--record", negative=())] = ()
    changes: Changes = ()
    axis: Axis = None
    again: Flag = False
    json: Path | None = None
    quiet: Quiet = False

    @property
    def record(self) -> Path | None:
        """The record given by --record, if any.

        Raises:
            MethodError: several are given.
        """
        if len(self.records) > 1:
            raise MethodError(f"This takes one record; received {len(self.records)} times --record: name one.")
        return self.records[0] if self.records else None

    @property
    def progress(self) -> Progress:
        """Listener to progress."""
        return listen(self.quiet)

    def load(self, joint: Path, *outputs: Path | None, alone: bool = False, method: str = "") -> File:
        """Load a joint or robot file with changes; see `jointid.config.load`.

        Args:
            joint: the file.
            outputs: files that the command writes, except the JSON.
            alone: whether the command takes a single joint only.
            method: method of a joint, instead of the file's.

        Raises:
            JointFileError: it cannot be loaded.
            MethodError: it is a robot file, and the command takes a joint.
            RecordError: an output is refused, see `spare`, or a record is given instead of the file.
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
        """Read the record of a joint or robot, and identify by `find`.

        Args:
            file: result of `load`.
            several: whether to identify several records, given or listed, in one fit.
            whole: whether to refuse a record that is too long to identify at once.
            window: length of the windows of a log that is read in chunks [s].
            asked: further arguments of `find`.

        Returns:
            The record, None for several, and the estimate.

        Raises:
            JointidError: the record cannot be read, or the identification fails.
        """
        from jointid.estimation.identify import windows_of
        from jointid.estimation.result.estimate import IN_WINDOWS

        listed = len(self.records) > 1 or file.source.parts or (file.runs and not self.records)
        together = several and window is None and bool(listed)
        read = file.record if window is None or file.robot is not None else file.log  # a robot's log is cut in memory
        record: Any = None if together else read(self.record)
        if whole and windows_of(record, file.setup, file.method):
            raise MethodError(IN_WINDOWS)
        return record, self.find(file, record, window, **asked)

    def find(
        self,
        file: File,
        record: Any,
        window: float | None = None,
        *,
        checks: bool = True,
        first: Callable[[Estimate], object] | None = None,
    ) -> Estimate:
        """Return the stored estimate of a record, or identify and store it; a refusal with its cause is stored, too.

        None stands for all given or listed records. `first` receives the estimate before its checks.
        """
        from jointid.diagnostics.explain import explain_failure
        from jointid.diagnostics.identify import LATER, check_later
        from jointid.estimation.identify import windows_of
        from jointid.output.json import keep, key_of, recall

        paths = self.records or (record is None and file.listed) or [Path(file.record_path())]
        key, progress = key_of(file, paths, self.axis, self.changes, window), self.progress

        def store(one: Estimate | None, **refusal: str) -> None:
            try:
                keep(place_of(file), key, one, **refusal)
            except RecordError as error:
                progress(f"the estimate is not kept: {error}")

        apart = record is not None and window is None and not windows_of(record, file.setup, file.method)
        apart = apart and (file.robot is not None or record.torque is not None)
        found = None if self.again else recall(place_of(file), file, key)
        if found is not None and not (checks and LATER in [one.values for one in found.checks]):
            return found
        ready(progress, file)
        try:
            if record is None:
                found = file.identify_together(self.records, progress)
            elif found is None or not apart:
                found = file.identify(record, progress, checks=checks and not apart, windows=window)
            store(found)
        except JointidError as error:
            alone = record is not None and window is None and file.robot is None
            if alone:
                error = explain_failure(error, record, file.loop, progress, getattr(file.method, "free", ()))
            if alone or type(error) is MethodError:  # others are of the record, and found before the search
                store(None, refused=str(error), code=error.code)
            raise error
        if checks and LATER in [one.values for one in found.checks]:
            if not self.quiet:
                tell(f"before its checks, which may change this answer: {found.sentence}")
            if first is not None:
                first(found)
            store(found := check_later(found, record, progress))
        return found


DEFAULTS = Options()


def place_of(file: File) -> Path:
    """Return the path of the stored estimate, beside the joint file."""
    return file.path.with_suffix(".estimate.json")


def show(line: object) -> None:
    """Print a line, with control characters escaped."""
    clear_bars()
    put(f"{printable(str(line))}\n", sys.stdout)


def show_result(result: Documented, *, details: bool = False) -> None:
    """Print a result, in colour on a terminal."""
    from jointid.common.document import plain_console

    document = result.to_document(details=details)
    if sys.stdout.isatty():
        clear_bars()
        document.print(plain_console())
    else:
        show(document.text())


def tell(message: str) -> None:
    """Print a line to the standard error."""
    put(f"{printable(message)}\n", sys.stderr)


def put(text: str, stream: IO[str]) -> None:
    """Print and flush; after an error, discard further output to the stream."""
    try:
        stream.write(text)
        stream.flush()
    except OSError as error:
        if stream is sys.stdout:
            unprinted.append(error)
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class Bars:
    """A progress line on the standard error: bar, stage and seconds.

    The line is removed at the end; sentences that are longer than a line remain.

    Args:
        console: to draw on; None takes the standard error.
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
        """Remove the line."""
        self._bar.stop()


_bars = lru_cache(maxsize=1)(Bars)


def listen(quiet: bool) -> Progress:
    """Return a progress listener: bars on a terminal, lines elsewhere."""
    if quiet:
        return ignore_progress
    if details:
        return tell
    if sys.stderr.isatty():
        return _bars()
    stage, printed = "", time.monotonic()

    def tell_stage(message: str) -> None:
        nonlocal stage, printed
        brief, now = message.brief if isinstance(message, Detail) else message, time.monotonic()
        if brief and brief != stage:
            stage, printed = brief, now
            tell(brief)
        elif isinstance(message, Detail) and message.pace and now - printed >= _BETWEEN:
            printed = now
            tell(message)

    return tell_stage


def clear_bars() -> None:
    """Remove progress bars from the terminal, before other output or the end."""
    if _bars.cache_info().currsize:
        _bars().clear()


def deliver(result: Documented, json: Path | None = None, *, details: bool = False) -> None:
    """Print a result by `show_result`, and write it as JSON if requested."""
    show_result(result, details=details)
    save(result, json)


def save(result: Documented, json: Path | None) -> None:
    """Write a result as JSON; None writes nothing."""
    from jointid.output import json as answers

    if json is not None:
        write_whole(json, answers.dumps(answers.to_dict(result)))


def ready(listener: Progress, file: File | None = None, *, derivatives: bool = True) -> None:
    """Load the compiled simulation of a file's joint, by default of lines; report a long compilation."""
    from jointid.simulation.warm_up import RIGID, warm_up

    said = "loading the simulation; the first time on a machine it is compiled, in about a minute"
    timer = threading.Timer(_PATIENCE, listener, [said])
    timer.start()
    try:
        if file is None or (file.robot is None and file.method.name != "idim"):  # these compile what they run
            warm_up(RIGID if file is None else file.joint, derivatives=derivatives)
    finally:
        timer.cancel()
