"""Signals: filters, derivatives and windows, unwrapping, encoder steps, and excitation."""
