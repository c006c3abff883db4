"""The paper's method: Algorithm 7.1 for the regularised dual problem, part by part of (D_gamma)."""
