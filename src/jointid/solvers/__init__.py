"""Minimise a problem, or solve its estimating equations, within bounds: `solve(problem, solver, start)`.

A solver is a frozen dataclass of its settings, one file for each kind; all of them return a `Solution`. No solver knows
what a joint is.
"""
