"""The default method: Newton's for the discrete problem itself, with nothing regularised.

Displacements at the nodes and the dual variable at the integration points are its unknowns.
"""
