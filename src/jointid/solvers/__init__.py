"""Solvers of a problem, which know nothing about joints: `solve(problem, solver, start)` returns a `Solution`."""
