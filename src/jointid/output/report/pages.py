"""What every report is written as: one page, Markdown with its figures, and the figures alone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from jointid.common.charts import Cells, Chart
from jointid.common.document import Block, Document, Paragraph, Picture
from jointid.common.errors import RecordError
from jointid.common.files import write_folder, write_whole
from jointid.common.parallel import Aside
from jointid.output.figures.bokeh_backend import plot
from jointid.output.figures.matplotlib_backend import png, svg
from jointid.output.report.page import page


class Pages(ABC):
    """A report: it has figures, and becomes a document, for the screen or for paper."""

    __slots__ = ()

    @property
    @abstractmethod
    def charts(self) -> dict[str, Chart]:
        """Its figures by name."""

    @abstractmethod
    def _document(self, *, interactive: bool) -> Document:
        """Return it as a document; where that is interactive its figures are plots, too, and it carries its answer."""

    def html(self) -> str:
        """Return one self-contained HTML page.

        Raises:
            ExtraError: bokeh or jinja2 is not installed.
        """
        return page(self._document(interactive=True))

    def markdown(self) -> str:
        """Return the same as Markdown; its figures are SVG files beside it, which `save` writes."""
        return self._document(interactive=False).markdown()

    def save(self, path: str | Path) -> Path:
        """Write the page.

        Args:
            path: of the file, which ends in .html.

        Raises:
            RecordError: another suffix, or the file cannot be written.
            ExtraError: bokeh or jinja2 is not installed.
        """
        path = Path(path)
        require_page(path)
        write_whole(path, self.html())
        return path

    def save_markdown(self, folder: str | Path) -> tuple[Path, ...]:
        """Write report.md and its figures into a folder, which is made; return what was written.

        Raises:
            RecordError: the folder or a file cannot be written.
        """
        document = self._document(interactive=False)
        return write_folder(folder, {"report.md": document.markdown().encode()} | document.pictures)

    def save_figures(self, folder: str | Path) -> tuple[Path, ...]:
        """Write every figure as PNG and as SVG into a folder, which is made; return what was written.

        Raises:
            RecordError: the folder or a file cannot be written.
        """
        files: dict[str, bytes] = {}
        for name, chart in self.charts.items():
            files |= {f"{name}.png": png(chart), f"{name}.svg": svg(chart)}
        return write_folder(folder, files)


def pictures_of(
    charts: Mapping[str, Chart], *, interactive: bool, absent: Callable[[str], str] = "Not available: {}".format
) -> Callable[[str], list[Block]]:
    """Return what gives the blocks of a picture by its name; where it is interactive they are plots, too, for a page.

    Each is drawn twice then, at the same time: by one library for the screen, by the other for paper.

    Args:
        charts: by name.
        interactive: whether they are for a page.
        absent: says why a picture of that name is not there.
    """
    plots: dict[str, str] = {}
    draw = {name: partial(svg, chart) for name, chart in charts.items()}
    if interactive:
        drawing = Aside(lambda: {name: svg(chart) for name, chart in charts.items()})
        plots = {name: plot(chart) for name, chart in charts.items()}
        draw = {name: partial(bytes, image) for name, image in drawing.result().items()}

    def picture(name: str) -> list[Block]:
        if name not in charts:
            return [Paragraph(absent(name))]
        chart = charts[name]
        narrow = any(isinstance(item, Cells) for panel in chart.panels for item in panel.items)
        return [Picture(f"{name}.svg", draw[name], chart.caption, plots.get(name, ""), not narrow)]

    return picture


def require_page(path: Path) -> None:
    """Raise a `RecordError` if a page cannot be saved under that name."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise RecordError(f'A report is saved as .html; received "{path.name}": change its suffix.')
