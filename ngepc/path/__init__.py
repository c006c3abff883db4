"""Path-following in gamma: Algorithm 7.2, its options, its state, its result."""

from ngepc.path.solver import follow_path as follow_path
