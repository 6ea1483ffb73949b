"""Rates and times of the methods, compared with other solvers."""
