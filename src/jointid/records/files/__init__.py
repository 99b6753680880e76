"""Inspect, convert and write files of any format."""
