"""Random problems and their functionals, for derivatives."""
