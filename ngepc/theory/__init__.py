"""Sections 3 and 6 made visible: duality gaps, and the norm gap with life without it."""
