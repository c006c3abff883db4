"""Numbers printed in the paper; they are written here only."""

TABLE_1 = {
    "1e0": (1, 1, 1, 1, 1, 1),
    "1e1": (1, 1, 1, 1, 1, 1),
    "1e2": (1, 1, 1, 1, 1, 1),
    "1e3": (8, 7, 9, 9, 10, 11),
    "1e4": (17, 21, 19, 22, 23, 26),
    "1e5": (73, 80, 86, 77, 80, 83),
    "1e5*": (73, 86, 65, 31, 24, 25),
    "1e6*": (193, 223, 224, 272, 226, 180),
}
"""Newton steps of Example (a) on 833 ... 24833 nodes; * is nested iteration."""

TABLE_2 = {
    "1e1": (2, 2, 2, 2, 2, 2),
    "1e2": (7, 7, 7, 7, 7, 7),
    "1e3": (12, 12, 13, 11, 13, 14),
    "1e4": (25, 22, 26, 22, 20, 21),
    "1e5": (43, 41, 49, 39, 36, 34),
    "1e6": (56, 61, 75, 69, 68, 70),
}
"""Newton steps of Example (b) on 873 ... 24993 nodes (the paper prints 24927 for the last)."""

TABLE_3_OUTER = (6, 6, 7, 7, 8, 8)
TABLE_3_INNER = (21, 23, 25, 41, 48, 72)
"""Outer and total inner iterations of Algorithm 7.2 on 873 ... 24993 nodes."""
