"""The discretised problem as arrays: points, strains, the law, supports, contact rows, spaces.

Everything that more than one solver needs; each formula is written once, here.

- the body, and the residual of an iterate: body, floating, held_by_contact
- integration points and strains: points, element_strains, moduli
- the law of the material at the points: law, laws, von_mises_law, hill_law, overlay_law,
  resistance
- tangents: stiffness, element_stiffness, symbolic_stiffness, summands, factors
- loads and supports at the nodes: loads, supports, slanted, roller_rows
- contact as rows: rows, conditions, contact_step, shared_forces, mortar, overlap
- gaps on facets: gap_records, facets, narrow, enclosed_gaps
- data that the points miss: finer, sampling, lattices, sampled
- what is known of coefficients: polynomials, formulas, operations
- spaces and rules of the paper's method: spaces, quadrature, prolongation
"""
