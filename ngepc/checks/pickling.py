"""Pickling and copying of problems and results: support for what NGSolve cannot pickle.

NGSolve pickles meshes, spaces and GridFunctions, but no coefficient with a normal vector in it, and
no integration rule.  Importing this module registers both with ``copyreg``, for ``pickle`` and
``copy.deepcopy``.
"""

import copyreg
import pickle

from ngsolve import CoefficientFunction, IntegrationRule, comp, specialcf

from ngepc.checks.coefficients import NOT_ARCHIVED
from ngepc.checks.sentences import in_words

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
    """(text, shape) of a coefficient in ``GEOMETRIC`` -> (name, dimension)."""
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
    """The reduction of a coefficient for pickle: its operands, or its name.

    PicklingError for one that NGSolve's archive refuses and that is not in ``KNOWN``.
    """
    try:
        return CoefficientFunction, (value.data,)
    except NOT_ARCHIVED as error:
        known = KNOWN.get(_key(value))
        if known is None:
            first = str(value).split("\n")[0]
            raise pickle.PicklingError(
                f"{in_words(first)} cannot be pickled: a number or another coefficient is needed"
            ) from error
        return geometric, known


def rule(value: IntegrationRule) -> tuple:
    """The reduction of an integration rule for pickle: its points and weights."""
    points = [tuple(point) for point in value.points]
    return IntegrationRule, (points, list(value.weights))


copyreg.pickle(CoefficientFunction, reduced)
copyreg.pickle(comp.GridFunctionCoefficientFunction, reduced)
copyreg.pickle(IntegrationRule, rule)
