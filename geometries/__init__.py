"""Bodies to solve on, each through Netgen CSG, and ``imported`` for meshes of other programs.

``lshape`` and ``wrench`` are the paper's examples; ``block`` (also with a hole, also of equal
cells), ``plate``, ``ring`` (also a spherical shell), ``cook`` and ``punch`` are for other problems,
``published`` has bodies of published ones.  Most modules offer ``mesh(maxh)``; the paper's examples
add ``paper_mesh(nodes)``, the exact family of bisected meshes behind its tables.  Boundaries are
called ``clamped``, ``load``, ``contact`` and ``free`` where a part has one use, by their place
(``left``, ``top``, ``hole``, ``inner``) where it has none of its own.
"""
