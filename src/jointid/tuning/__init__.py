"""Tuning: margins of an estimate's loop, gains, a notch and feed-forward."""
