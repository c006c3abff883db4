"""The command line: ``commands`` has all options in tables, ``work`` carries them out."""
