"""Sections 3 and 6 made visible: duality gaps, the norm gap, Newton's method in lambda and in v."""
