"""Faults of the loop, the log, the record and the mechanics: one definition each, in `registry`."""
