"""The data of a time step, checked when the problem is made; no spaces and no solvers.

- the problem: problem, data, own, features
- checks: checks, mesh_checks, material_checks, support
- material: material, tensile, hardening, viscosity, hill, overlay
- body and conditions: kinematics, elements, located, places, obstacles, round
- meshes that processes share: parts, processes
"""
