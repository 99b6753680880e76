"""Signals: filters, derivatives and windows."""
