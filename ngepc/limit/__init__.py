"""Limit loads and shakedown with guarantees from both sides: admissible stresses and mechanisms.

- limit loads, mesh by mesh: load, outcome, bracket, bisection
- loads that vary: shakedown, cycles, elastic
- data of a problem: reading, data, yielding, rigid
- the lower bound: static, statics_proof
- the upper bound: continuous, sliding, flow, flow_proof, mechanism
- rounding errors, enclosed: enclosed, outline, repair
- functions to draw: fields
"""
