"""The independent witness: Newton's method for the reduced primal energy."""
