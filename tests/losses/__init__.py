"""Attacks on what the program writes: signals, full disks, damaged caches, outputs that show or take nothing.

A part runs with ``pytest -m hostile``; the whole, 200 moments of every command and 50 sizes of a full disk for every
writer, with ``JOINTID_ATTACKS=200 pytest -m hostile tests/losses``; in parts with a ``JOINTID_ATTACKS_SEED`` for each.
"""
