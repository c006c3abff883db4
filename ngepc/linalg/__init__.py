"""Linear algebra without finite elements: direct solvers, complementarity, step lengths."""
