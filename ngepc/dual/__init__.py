"""The paper's method: Algorithm 7.1 for (D_gamma), part by part, and Algorithm 7.2 along gamma."""
