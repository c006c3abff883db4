"""The command line: ``ngepc solve``, ``path``, ``study``, ``report``, ``notebooks``.

``commands`` has the options of all in tables, a module for each command has ``run(arguments)``.
"""
