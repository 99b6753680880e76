"""Figures and tables; this room only ever reads answers."""
