"""Informative motions of a robot within its joint limits."""
