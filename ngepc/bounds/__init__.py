"""Guaranteed bounds of the energy error, and meshes that follow them."""
