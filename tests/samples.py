"""Small things that several test files need: a matrix, a monitor, the numbers of a state."""

import numpy as np
from scipy.sparse import diags, eye, kron


def grid_laplacian(n):
    """The Laplacian of n x n points of a grid, as a sparse matrix."""
    line = diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(n, n))
    return (kron(line, eye(n)) + kron(eye(n), line)).tocsr()


def scaled_laplacian(n):
    """The same with rows and columns times random numbers: no product of two lines."""
    random = np.random.default_rng(3)
    scale = diags(random.uniform(0.5, 2.0, n * n))
    return (scale @ grid_laplacian(n) @ scale).tocsr()


def stop_after(number):
    """A monitor that ends a run at this record."""
    seen = []

    def monitor(record):
        seen.append(record)
        if len(seen) == number:
            raise StopIteration

    return monitor


def state_of(result):
    """All numbers of the state that a result keeps."""
    if hasattr(result, "v"):
        return np.r_[result.y.FV().NumPy(), result.v.FV().NumPy()]
    return result.displacement.vec.FV().NumPy()
