"""Solvers of a problem or its estimating equations: `solve(problem, solver, start)`.

A solver is a frozen dataclass of settings and returns a `Solution`; it knows nothing about joints.
"""
