"""The subcommands of ``ngepc``, one module each: ``configure(parser)`` and ``run(arguments)``.

Modules here import NGSolve only inside ``run``, so that help and usage errors answer at once.
"""
