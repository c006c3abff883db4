"""What lets problems, results and histories be pickled and copied: parts of NGSolve that are not.

NGSolve pickles meshes, spaces and GridFunctions, but no coefficient with a normal vector in it, and
no integration rule.  Importing this module tells ``copyreg``, and with it ``pickle`` and
``copy.deepcopy``, how.
"""

import copyreg
import pickle

from ngsolve import CoefficientFunction, IntegrationRule, comp, specialcf

GEOMETRIC = {
    "normal": specialcf.normal,
    "tangential": specialcf.tangential,
    "JacobianMatrix": specialcf.JacobianMatrix,
    "xref": specialcf.xref,
}
"""Coefficients of a dimension that NGSolve's archive refuses, by their name in ``specialcf``."""


def _key(value: CoefficientFunction) -> tuple:
    return str(value), tuple(value.dims)


def _geometric() -> dict[tuple, tuple[str, int | None]]:
    """Text and shape of each of these coefficients -> its name and dimension."""
    known: dict[tuple, tuple[str, int | None]] = {}
    for name, make in GEOMETRIC.items():
        for N in (1, 2, 3):
            known.setdefault(_key(make(N)), (name, N))
    known[_key(specialcf.mesh_size)] = "mesh_size", None
    return known


def geometric(name: str, N: int | None) -> CoefficientFunction:
    """The coefficient called ``name`` in ``specialcf``, in N dimensions if it has any."""
    return specialcf.mesh_size if N is None else GEOMETRIC[name](N)


KNOWN = _geometric()


def reduced(value: CoefficientFunction) -> tuple:
    """How a coefficient is made again: of its parts, or by its name.

    PicklingError for one that NGSolve's archive refuses and that is none of ``KNOWN``.
    """
    try:
        return CoefficientFunction, (value.data,)
    except Exception as error:  # NGSolve's archive
        known = KNOWN.get(_key(value))
        if known is None:
            first = str(value).split("\n")[0]
            raise pickle.PicklingError(
                f"{first!r} cannot be pickled: a number or another coefficient is needed"
            ) from error
        return geometric, known


def rule(value: IntegrationRule) -> tuple:
    """How an integration rule is made again."""
    points = [tuple(point) for point in value.points]
    return IntegrationRule, (points, list(value.weights))


copyreg.pickle(CoefficientFunction, reduced)
copyreg.pickle(comp.GridFunctionCoefficientFunction, reduced)
copyreg.pickle(IntegrationRule, rule)
