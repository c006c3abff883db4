"""Derivatives of solutions with respect to data, and calibration with them."""
