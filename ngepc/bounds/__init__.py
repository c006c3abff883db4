"""Guaranteed bounds of the energy error, by stresses in equilibrium on meshes of every kind."""
