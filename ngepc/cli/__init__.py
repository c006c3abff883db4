"""The command line: ``ngepc solve``, ``path``, ``study``, ``report``, ``notebooks``.

One module for each command, with ``configure(parser)`` and ``run(arguments)``; they import NGSolve
only inside ``run``, so that help and usage errors answer at once.
"""
