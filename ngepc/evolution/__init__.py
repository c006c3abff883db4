"""Several time steps in a row: the load path, what the body remembers, the file of a history."""
