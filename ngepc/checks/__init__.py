"""Checks of single arguments: each failure names the argument, its value and what is needed.

The lowest room: it knows numbers, texts, objects and NGSolve's coefficients, but no problem.
"""
