"""Guaranteed intervals of forces and displacements: meshes that follow them, verdicts, receipts."""
