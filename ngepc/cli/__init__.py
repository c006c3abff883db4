"""The command line: ``commands`` has all options in tables; the others carry them out."""
