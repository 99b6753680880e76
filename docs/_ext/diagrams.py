"""The block diagrams of docs/controllers.md, as SVG in docs/images.

python docs/_ext/diagrams.py        writes them again

Each has a white panel of its own, so that it reads on a light and on a dark page.
"""

from __future__ import annotations

from html import escape
from pathlib import Path

IMAGES = Path(__file__).resolve().parents[1] / "images"

_INK, _CODE, _PALE = "#1b2733", "#0b5394", "#eef3f8"
_RADIUS = 10  # of a sum, pixels
_HALF = 22  # height of a block from its middle, pixels


class Drawing:
    """A block diagram: its elements, and the keys of `[controller]` that it names.

    Attributes:
        keys: names in the blocks, in their order.
    """

    def __init__(self, title: str, width: int, height: int) -> None:
        self.keys: list[str] = []
        self._parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
            f'role="img" font-family="Arial, Helvetica, sans-serif" font-size="13" fill="{_INK}">',
            f"<title>{escape(title)}</title>",
            '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
            f'<path d="M0 0 L8 4 L0 8 z" fill="{_INK}"/></marker></defs>',
            f'<rect width="{width}" height="{height}" rx="8" fill="#ffffff"/>',
        ]

    def text(self, x: float, y: float, said: str, *, anchor: str = "middle", small: bool = False) -> None:
        """Write plain words."""
        size = ' font-size="11"' if small else ""
        self._parts.append(f'<text x="{x}" y="{y}" text-anchor="{anchor}"{size}>{escape(said)}</text>')

    def block(self, left: float, right: float, y: float, *lines: str) -> None:
        """Draw a block; a line in backticks is a key."""
        half = _HALF if len(lines) < 3 else 8 * len(lines) + 6
        self._parts.append(
            f'<rect x="{left}" y="{y - half}" width="{right - left}" height="{2 * half}" rx="4" fill="{_PALE}" '
            f'stroke="{_INK}"/>'
        )
        top = y + 4.5 - 8 * (len(lines) - 1)
        for row, line in enumerate(lines):
            key = line.strip("`")
            style = ""
            if key != line:
                self.keys.append(key)
                style = f' font-family="Consolas, Menlo, monospace" font-size="12" fill="{_CODE}"'
            self._parts.append(
                f'<text x="{(left + right) / 2}" y="{top + 16 * row}" text-anchor="middle"{style}>{escape(key)}</text>'
            )

    def sum(self, x: float, y: float, *signs: tuple[float, float, str]) -> None:
        """Draw a sum with signs beside it."""
        self._parts.append(f'<circle cx="{x}" cy="{y}" r="{_RADIUS}" fill="#ffffff" stroke="{_INK}"/>')
        for dx, dy, sign in signs:
            self.text(x + dx, y + dy, sign)

    def wire(self, *points: tuple[float, float], tip: bool = True, dashed: bool = False) -> None:
        """Draw a line through points, with an arrow at its end."""
        path = " ".join(f"{'L' if k else 'M'}{x} {y}" for k, (x, y) in enumerate(points))
        end = ' marker-end="url(#tip)"' if tip else ""
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        self._parts.append(f'<path d="{path}" fill="none" stroke="{_INK}" stroke-width="1.3"{dash}{end}/>')

    def dot(self, x: float, y: float) -> None:
        """Draw the point where a wire begins on another."""
        self._parts.append(f'<circle cx="{x}" cy="{y}" r="2.6"/>')

    def frame(self, left: float, top: float, right: float, bottom: float, said: str) -> None:
        """Draw a dashed frame with words above it."""
        self._parts.append(
            f'<rect x="{left}" y="{top}" width="{right - left}" height="{bottom - top}" rx="6" fill="none" '
            'stroke="#7a8896" stroke-dasharray="4 4"/>'
        )
        self.text(left + 6, top - 5, said, anchor="start", small=True)

    def svg(self) -> str:
        """Return the picture."""
        return "\n".join([*self._parts, "</svg>"]) + "\n"


def cascade() -> Drawing:
    """A position loop that commands a speed loop."""
    d = Drawing("The cascade: a position loop commands a speed loop", 960, 300)
    y, q = 120, 270
    d.text(42, y - 8, "reference")
    d.wire((12, y), (90, y))
    d.block(90, 215, y, "`interpolation`", "`reference_delay`")
    d.frame(262, 28, 522, 178, "every position_period, held in between")
    d.wire((215, y), (280, y))
    d.sum(290, y, (-16, -8, "+"), (14, 22, "−"))
    d.wire((300, y), (330, y))
    d.block(330, 450, y, "`position_gain`")
    d.wire((450, y), (480, y))
    d.sum(490, y, (-16, -8, "+"), (14, -14, "+"))
    d.dot(240, y)
    d.wire((240, y), (240, 60), (305, 60))
    d.block(305, 465, 60, "d/dt", "`velocity_feedforward`")
    d.wire((465, 60), (490, 60), (490, y - _RADIUS))
    d.wire((500, y), (545, y))
    d.block(545, 655, y, "`velocity_limit`")
    d.wire((655, y), (690, y))
    d.sum(700, y, (-16, -8, "+"), (14, 22, "−"))
    d.wire((710, y), (745, y))
    d.block(745, 875, y, "`velocity_gain`", "(1 + 1 / (Tn s))")
    d.text(810, y + 38, "Tn = integral_time", small=True)
    d.wire((875, y), (945, y))
    d.text(912, y - 8, "u")
    d.text(895, q - 8, "motor position")
    d.wire((945, q), (290, q), (290, y + _RADIUS))
    d.dot(700, q)
    d.wire((700, q), (700, 232))
    d.block(635, 765, 210, "d/dt", "`velocity_filter`")
    d.wire((700, 188), (700, y + _RADIUS))
    return d


def _parallel(title: str, *, integral: bool) -> Drawing:
    """Return a PD law, or a PID law with the integral above it."""
    y = 120 if integral else 60
    low, box, q = y + 100, y + 165, y + 225
    d = Drawing(title, 720, q + 30)
    d.text(42, y - 8, "reference")
    d.wire((12, y), (90, y))
    d.block(90, 215, y, "`interpolation`", "`reference_delay`")
    d.wire((215, y), (265, y))
    d.sum(275, y, (-16, -8, "+"), (14, 22, "−"))
    d.wire((285, y), (400, y))
    d.block(400, 520, y, "`position_gain`")
    d.wire((520, y), (600, y))
    d.sum(610, y, (-16, -8, "+"), (14, 22, "+"))
    d.wire((620, y), (705, y))
    d.text(665, y - 8, "u")
    if integral:
        d.dot(320, y)
        d.wire((320, y), (320, 45), (400, 45))
        d.block(400, 520, 45, "`integral_gain`", "1 / s")
        d.wire((520, 45), (610, 45), (610, y - _RADIUS))
        d.text(622, y - 16, "+")
    d.dot(240, y)
    d.wire((240, y), (240, low), (300, low))
    d.block(300, 420, low, "d/dt", "`velocity_filter`")
    d.wire((420, low), (440, low))
    d.sum(450, low, (-14, -10, "+"), (14, 22, "−"))
    d.wire((460, low), (480, low))
    d.block(480, 600, low, "`derivative_gain`")
    d.wire((600, low), (610, low), (610, y + _RADIUS))
    d.text(655, q - 8, "motor position")
    d.wire((705, q), (275, q), (275, y + _RADIUS))
    d.dot(450, q)
    d.wire((450, q), (450, box + _HALF))
    d.block(390, 510, box, "d/dt", "`velocity_filter`")
    d.wire((450, box - _HALF), (450, low + _RADIUS))
    return d


def pd() -> Drawing:
    """A PD law on position and speed."""
    return _parallel("The PD law", integral=False)


def pid() -> Drawing:
    """A PID law, with the integral of the position error."""
    return _parallel("The PID law", integral=True)


def state_space() -> Drawing:
    """Any linear sampled law."""
    d = Drawing("A state-space law", 720, 180)
    for y, said in ((57, "reference"), (85, "reference velocity"), (113, "motor position")):
        d.text(70, y - 6, said)
        d.wire((12, y), (150, y))
    d.block(
        150, 420, 85, "u = C z + D · inputs", "z ← A z + B · inputs + B_excess e", "n states z", "tables A, B, C and D"
    )
    d.wire((420, 85), (510, 85))
    d.text(465, 77, "u")
    d.block(510, 600, 85, "`limit`")
    d.wire((600, 85), (705, 85))
    d.wire((555, 107), (555, 165), (285, 165), (285, 123))
    d.text(490, 160, "e, what the limit cuts off", small=True)
    return d


def torque() -> Drawing:
    """From the output of a law to the torque that acts."""
    d = Drawing("From the output of a law to the torque that acts", 960, 270)
    y = 150
    d.text(28, y - 8, "u")
    d.wire((12, y), (90, y))
    d.block(
        15,
        205,
        50,
        "`acceleration_feedforward`",
        "`viscous_feedforward`",
        "`coulomb_feedforward`",
        "`constant_feedforward`",
    )
    d.wire((100, 88), (100, y - _RADIUS))
    d.sum(100, y, (-16, -8, "+"), (14, -14, "+"))
    d.wire((110, y), (150, y))
    d.block(150, 215, y, "`gain`")
    d.wire((215, y), (265, y))
    d.sum(275, y, (-16, -8, "+"), (14, -14, "+"))
    d.text(275, 112, 'injected, at = "before_limit"', small=True)
    d.wire((275, 118), (275, y - _RADIUS))
    d.wire((285, y), (320, y))
    d.block(320, 450, y, "`torque_filters`", "before the limit")
    d.wire((450, y), (485, y))
    d.block(485, 555, y, "`limit`")
    d.wire((555, y), (600, y))
    d.block(600, 730, y, "`torque_filters`", "after the limit")
    d.wire((730, y), (765, y))
    d.block(765, 830, y, "`delay`")
    d.wire((830, y), (865, y))
    d.sum(875, y, (-14, -12, "+"), (14, -14, "+"))
    d.text(875, 112, 'injected, at = "after_limit"', small=True)
    d.wire((875, 118), (875, y - _RADIUS))
    d.wire((885, y), (945, y))
    d.text(920, y - 10, "acts")
    for x, tap in ((578, "command"), (748, "filtered"), (905, "measured")):
        d.dot(x, y)
        d.wire((x, y), (x, 205), tip=False, dashed=True)
        d.text(x, 222, f'tap = "{tap}"', small=True)
    d.text(480, 252, "filters_at chooses one of both places for the filters", small=True)
    return d


DIAGRAMS = {"law-cascade": cascade, "law-pd": pd, "law-pid": pid, "law-state-space": state_space, "law-torque": torque}
"""By the name of the file, what draws it."""


if __name__ == "__main__":
    for name, draw in DIAGRAMS.items():
        (IMAGES / f"{name}.svg").write_text(draw().svg(), encoding="utf-8")
