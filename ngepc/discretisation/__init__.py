"""From a problem to arrays: integration points, strains, the law, supports, contact rows, spaces.

Everything that more than one solver needs, and the one place of each formula.
"""
