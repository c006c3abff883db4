"""The version of ngepc, on its own so that it can be read without importing NGSolve."""

__version__ = "1.0.0"
