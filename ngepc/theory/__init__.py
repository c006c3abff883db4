"""Sections 3, 4 and 6 made visible: duality gaps, shifts as multipliers, the norm gap."""
