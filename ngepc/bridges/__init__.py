"""Bridges to JAX and PyTorch: numbers of a solution as functions that these can differentiate."""

from ngepc.bridges.functions import jax_function as jax_function
from ngepc.bridges.functions import torch_function as torch_function
