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
    d = Drawing("The cascade: a position loop commands a speed loop", 760, 300)
    y, q = 120, 270
    d.text(31, y - 30, "reference")
    d.wire((8, y), (50, y))
    d.block(50, 170, y, "`interpolation`", "`reference_delay`")
    d.frame(194, 28, 394, 178, "every position_period, held in between")
    d.wire((170, y), (206, y))
    d.sum(216, y, (-16, -8, "+"), (14, 22, "−"))
    d.wire((226, y), (244, y))
    d.block(244, 346, y, "`position_gain`")
    d.wire((346, y), (362, y))
    d.sum(372, y, (-14, -10, "+"), (14, -14, "+"))
    d.dot(182, y)
    d.wire((182, y), (182, 60), (203, 60))
    d.block(203, 357, 60, "d/dt", "`velocity_feedforward`")
    d.wire((357, 60), (372, 60), (372, y - _RADIUS))
    d.wire((382, y), (408, y))
    d.block(408, 518, y, "`velocity_limit`")
    d.wire((518, y), (540, y))
    d.sum(550, y, (-16, -8, "+"), (14, 22, "−"))
    d.wire((560, y), (584, y))
    d.block(584, 690, y, "`velocity_gain`", "(1 + 1 / (Tn s))")
    d.text(637, y + 38, "Tn = integral_time", small=True)
    d.wire((690, y), (748, y))
    d.text(718, y - 8, "u")
    d.text(700, q - 8, "motor position")
    d.wire((748, q), (216, q), (216, y + _RADIUS))
    d.dot(550, q)
    d.wire((550, q), (550, 232))
    d.block(490, 610, 210, "d/dt", "`velocity_filter`")
    d.wire((550, 188), (550, y + _RADIUS))
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
    d = Drawing("From the output of a law to the torque that acts", 760, 260)
    y = 150
    d.text(24, y - 8, "u")
    d.wire((8, y), (52, y))
    feed_forwards = [f"`{name}_feedforward`" for name in ("acceleration", "viscous", "coulomb", "constant")]
    d.block(8, 190, 46, *feed_forwards)
    d.wire((62, 84), (62, y - _RADIUS))
    d.sum(62, y, (-14, -12, "+"), (14, -14, "+"))
    d.wire((72, y), (96, y))
    d.block(96, 150, y, "`gain`")
    d.wire((150, y), (176, y))
    d.sum(186, y, (-14, -12, "+"), (14, -14, "+"))
    d.text(186, 108, 'injected, at = "before_limit"', small=True)
    d.wire((186, 114), (186, y - _RADIUS))
    d.wire((196, y), (216, y))
    d.block(216, 328, y, "`torque_filters`")
    d.wire((328, y), (436, y))
    d.block(436, 548, y, "`limit`")
    d.wire((548, y), (578, y))
    d.block(578, 632, y, "`delay`")
    d.wire((632, y), (656, y))
    d.sum(666, y, (-14, -12, "+"), (14, -14, "+"))
    d.text(666, 108, 'injected, at = "after_limit"', small=True)
    d.wire((666, 114), (666, y - _RADIUS))
    d.wire((676, y), (748, y))
    d.text(730, y - 8, "acts")
    for x, tap in ((560, "command"), (700, "measured")):
        d.dot(x, y)
        d.wire((x, y), (x, 200), tip=False, dashed=True)
        d.text(x, 216, f'tap = "{tap}"', small=True)
    return d


DIAGRAMS = {"law-cascade": cascade, "law-pd": pd, "law-pid": pid, "law-state-space": state_space, "law-torque": torque}
"""By the name of the file, what draws it."""


if __name__ == "__main__":
    for name, draw in DIAGRAMS.items():
        (IMAGES / f"{name}.svg").write_text(draw().svg(), encoding="utf-8")
