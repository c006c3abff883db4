"""Guaranteed intervals of forces and displacements: meshes that follow them, verdicts, receipts.

- the interval of a goal on a mesh: goal_bound, best_lambda, goal_interval, kinds, goal_terms,
  resultant, roller_motion
- its adjoint: adjoint, adjoint_conditions, held_rows
- the supremum over the unknown strain, and its integral: integrand, supremum, supremum_of_laws,
  supremum_of_ellipsoids, sub_elements, sides, goal_boundary
- integrals from above: cutting, pieces, varying
- adaptive meshes: adaptive, refinement, planning, one_mesh, ends, clock
- answers in a sentence: verdicts, confidence, variants
- brackets from energies, without an adjoint: brackets
- receipts: receipt, receipt_arrays, receipt_mesh, receipt_file, check_receipt
"""
