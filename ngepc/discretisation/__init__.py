"""The discretised problem as arrays: points, strains, the law, supports, contact rows, spaces.

Everything that more than one solver needs; each formula is written once, here.
"""
