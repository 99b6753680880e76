"""Identify a servo-driven joint from motor torque and the commanded reference alone."""
