"""Guaranteed bounds of the energy error, and adaptive refinement."""
