"""What is to be solved, checked when it is made; nothing here knows a space or a solver."""
