"""Rows of tables for reports, in which vectors and mappings have columns of their own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

Rows = list[dict[str, object]]


def row(quantity: str, value: object) -> dict[str, object]:
    """A row of a table."""
    return {"quantity": quantity, "value": value}


def flat_rows(rows: Rows) -> Rows:
    """Rows whose vectors and mappings stand in columns of their own: 'reaction_x'."""
    return [dict(item for k, v in one.items() for item in flat(k, v)) for one in rows]


def flat(name: str, value: object) -> list[tuple[str, object]]:
    """A value, or the parts of a vector or a mapping, by their names."""
    if isinstance(value, Mapping):
        pairs = [
            (f"{letter}:{k}", v) for k, vs in value.items() for letter, v in parts(vs)
        ]
        return [(f"{name.removesuffix('s')}_{where}", v) for where, v in pairs]
    if isinstance(value, list | tuple | np.ndarray):
        return [(f"{name}_{letter}", v) for letter, v in parts(value)]
    return [(name, value)]


def parts(vector: object) -> list[tuple[str, float]]:
    """x, y, z and the components of a vector."""
    return [(letter, float(v)) for letter, v in zip("xyz", vector, strict=False)]
