"""An independent second solver: Newton's method for the reduced primal energy."""
