"""Figures: described once, drawn by matplotlib for print and by bokeh for the screen."""
