"""Guaranteed bounds of the energy error, by stresses in equilibrium on meshes of every kind.

- the bound of a result, and what it says: bound, of_state, outcome, coverage, sizes, thickness
- data that the bounds of all states on a mesh share: data, boundary, contact, row_stresses,
  oscillation, foundation, rollers, held
- stresses in equilibrium, from those of a state: equilibration, element, balance, nearby
- the best of them in the plane, by Airy functions: plane, airy, levels, edge_rows, vertex_matrix,
  frames
- in three dimensions: solid, faces, face_matrix
- of a body of revolution: revolution, ring_stress, ring_search, ring_element, ring_density,
  ring_energy, ring_integrals
- the energy density phi and its conjugate phi*, integrated from above: densities, conjugate,
  convex, flow_potentials
- simplices, and polynomials on them: simplices, polynomials, coordinates, enclosure
- quadrilaterals and hexahedra, cut into simplices: counterpart, quadrilaterals, hexahedra,
  mapping, mapped, upper_energy, least_flow
- other meshes of the same body: corners, copies, bisection, matching, transfer, displacements
- what Newton's method has left of the error: algebraic
"""
