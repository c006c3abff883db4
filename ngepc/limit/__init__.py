"""Limit loads and shakedown with guarantees from both sides: admissible stresses and mechanisms."""
