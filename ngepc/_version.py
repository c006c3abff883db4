"""The version of ngepc, on its own so that it can be read without importing NGSolve."""

__version__ = "0.1.0"
