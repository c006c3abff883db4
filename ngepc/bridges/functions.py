"""A ``Response`` as a function of JAX or PyTorch, whose derivative is that of ``gradient``.

There are no difference quotients, and the solver is not traced: the value comes from a solve, and
the derivative from one linear solve with its last tangent.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ngepc.checks.kinds import require_instance
from ngepc.sensitivity.response import Response

NEEDED = "a Response"


def jax_function(response: Response) -> Callable[[Any], Any]:
    """A function of JAX: parameters, shape (n,), to a number; for ``jax.grad`` and ``jax.jit``.

    Parameters
    ----------
    response
        The number of a solution as a function of its data.

    Returns
    -------
    function
        It has a ``custom_vjp``.  With ``jax.config.update("jax_enable_x64", True)`` numbers have
        the solver's precision.

    Raises
    ------
    TypeError
        If it is no ``Response``.
    ImportError
        If JAX is missing; the message says what to install.
    """
    require_instance("response", response, Response, NEEDED)
    try:
        import jax
    except ImportError as error:
        raise ImportError('jax_function needs JAX: pip install "ngepc[jax]"') from error

    def solved(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The number and its gradient, in the precision of the parameters."""
        value, slope = response(np.asarray(theta, dtype=float))
        return np.asarray(value, theta.dtype), np.asarray(slope, theta.dtype)

    def both(theta: Any) -> Any:
        """The number and its gradient, called back from JAX."""
        shapes = (
            jax.ShapeDtypeStruct((), theta.dtype),
            jax.ShapeDtypeStruct(theta.shape, theta.dtype),
        )
        return jax.pure_callback(solved, shapes, theta)

    @jax.custom_vjp
    def function(theta: Any) -> Any:
        """The number."""
        return both(theta)[0]

    def backward(slope: Any, upstream: Any) -> tuple:
        """The gradient times the derivative of what follows."""
        return (upstream * slope,)

    function.defvjp(both, backward)
    return function


def torch_function(response: Response) -> Callable[[Any], Any]:
    """A function of PyTorch: a tensor of parameters, shape (n,), to a number; for ``backward``.

    Parameters
    ----------
    response
        The number of a solution as a function of its data.

    Returns
    -------
    function
        That of a ``torch.autograd.Function``.

    Raises
    ------
    TypeError
        If it is no ``Response``.
    ImportError
        If PyTorch is missing; the message says what to install.
    """
    require_instance("response", response, Response, NEEDED)
    try:
        import torch
    except ImportError as error:
        needed = 'torch_function needs PyTorch: pip install "ngepc[torch]"'
        raise ImportError(needed) from error

    class Solved(torch.autograd.Function):
        """The value of a solve; backwards the derivative that ``gradient`` gives."""

        @staticmethod
        def forward(context: Any, theta: Any) -> Any:
            """The number; its gradient is kept for ``backward``."""
            value, slope = response(theta.detach().cpu().double().numpy())
            context.save_for_backward(theta.new_tensor(slope))
            return theta.new_tensor(value)

        @staticmethod
        def backward(context: Any, upstream: Any) -> Any:
            """The gradient times the derivative of what follows."""
            (slope,) = context.saved_tensors
            return upstream * slope

    return Solved.apply
