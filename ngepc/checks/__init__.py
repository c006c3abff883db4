"""Checks of single arguments: each failure names the argument, its value and what is needed."""
