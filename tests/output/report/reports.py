"""Reports that several tests look at, each made once."""

from functools import cache
from html.parser import HTMLParser

import numpy as np

import jointid as ji
from jointid.common.document import Document, Table, Text
from jointid.output.report import Report
from tests.mistakes import cut

VOID = ("meta", "link", "br", "hr", "img", "input")
EVIL = "<script>document.title='x'</script></script><!--[a](javascript:x)|"


class Elements(HTMLParser):
    """The elements of a text, as a browser takes it apart; each that is closed was the last to be opened."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)
        self.close()

    @property
    def tags(self) -> list[str]:
        return [tag for tag, _ in self.found]

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.found if name == tag]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def rigid_record(
    seed: int = 1, name: str = "run", seconds: float = 6.0, inertia: float = 0.04
) -> tuple[ji.Record, ji.ClosedLoop]:
    """A small rigid joint under a cascade, with noise in its log."""
    loop = ji.ClosedLoop(
        ji.RigidJoint("revolute"), ji.controller.Cascade(position_gain=40.0, velocity_gain=2.0, limit=20.0)
    )
    values = {"inertia": inertia, "viscous": 0.05, "coulomb": 0.1, "offset": 0.02}
    reference = ji.excitation.trapezoids([0.5, 1.0, 2.0], 8.0, 2.0, 1e-3, duration=seconds)
    noise = 0.01 * np.random.default_rng(seed).standard_normal(reference.size)
    return ji.simulated_record(loop, reference, values, sample_time=1e-3, torque_noise=noise, name=name), loop


def marked(report: Report) -> str:
    """Return a report as text: headings behind #, cells of tables between |, all else on a line each."""
    lines = [f"# {report.title}"]
    for block in report.to_document().blocks:
        if isinstance(block, Text) and block.style in ("heading", "part"):
            lines.append(f"{'##' if block.style == 'heading' else '###'} {block.text}")
        elif isinstance(block, Table):
            lines += [f"| {' | '.join(row)} |" for row in (block.header, *block.rows)]
        else:
            lines.append(Document("", (block,)).text(10**6).strip())
    return "\n".join(lines)


@cache
def rigid() -> Report:
    """Of a rigid joint by DIDIM, from a record with a hostile name."""
    record, loop = rigid_record(name=EVIL)
    return ji.Report.of(ji.identify(record, loop), record, name=EVIL, profiles=["inertia", "coulomb"])


@cache
def idim() -> Report:
    """Of the same joint by IDIM."""
    record, loop = rigid_record()
    return ji.Report.of(ji.identify(record, loop.joint), record)


@cache
def flexible() -> Report:
    """Of the twin's flexible joint, by 12 s of its 24."""
    axis = ji.twin()
    record = cut(axis.record.without("motor_position", "load_position"), 12.0)
    return ji.Report.of(ji.identify(record, axis.loop, ji.DIDIM(frequency=30.0)), record, profiles=["stiffness"])
