"""``semismooth_newton``, which chooses between the exact method and the paper's."""
