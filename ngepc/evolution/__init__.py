"""Load histories: the load path, time steps with their history variables, checkpoints."""
