"""Checks on many problems: random data, data at their extremes, an independent look at results."""
