"""Linear algebra without finite elements: direct solvers, complementarity, step lengths.

- linear systems: direct, descent, cores, blas
- multigrid: aggregation, cycle, chebyshev, morton
- line searches: linesearch
- forces of contact and friction: secants, box, friction, friction_law, friction_equation,
  row_blocks, contact_states, other_forces
- conic programs: conic
- rounding errors, enclosed: intervals, jets
- polynomials: bernstein
"""
