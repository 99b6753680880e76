"""Figures: described once as charts, drawn by matplotlib for print and by bokeh for the screen."""

from jointid.output.figures.figures import (
    channels_figure,
    require_format,
    residual_figure,
    save,
    torque_figure,
    torque_png,
    tuning_figure,
)

__all__ = [
    "channels_figure",
    "require_format",
    "residual_figure",
    "save",
    "torque_figure",
    "torque_png",
    "tuning_figure",
]
