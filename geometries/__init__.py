"""Bodies to solve on: the paper's two examples and blocks, each through Netgen CSG.

Every module offers ``mesh(maxh)``; the paper's examples add ``paper_mesh(nodes)``, the exact
family of bisected meshes behind its tables.  Boundaries are named ``clamped``, ``load``,
``contact`` and ``free`` throughout.
"""
