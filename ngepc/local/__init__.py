"""The default method: Newton's method for the discrete problem, without regularisation.

Displacements at the nodes and the dual variable at the integration points are its unknowns.
"""
