"""Figures: described once as charts, drawn by matplotlib for paper and by bokeh for the screen."""

from jointid.output.figures.figures import residual_figure, save, torque_figure
from jointid.output.figures.tuning_figure import tuning_figure

__all__ = ["residual_figure", "save", "torque_figure", "tuning_figure"]
