"""Tensors of the paper's law in two dimensions and of solids, by the dimension N alone."""

from ngsolve import Grad, Sym

from ngepc.model.kinematics import SOLID, TWO_DIMENSIONAL

OF_DIMENSION = {2: TWO_DIMENSIONAL, 3: SOLID}


def basis(N):
    return OF_DIMENSION[N].basis.copy()


def coordinates_count(N):
    return OF_DIMENSION[N].d


def coordinates(A, N):
    return OF_DIMENSION[N].coordinates(A)


def tensor(p, N):
    return OF_DIMENSION[N].tensor(p)


def deviator(A, N):
    return OF_DIMENSION[N].deviator(A)


def strain(u):
    return Sym(Grad(u))
