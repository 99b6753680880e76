"""Minimise a problem, or solve its estimating equations, within bounds: `solve(problem, solver, start)`.

One solver stands in each file, as a frozen dataclass of its settings; all of them return a `Solution`. No solver knows
what a joint is.
"""
