"""The command line: ``commands`` has all options in tables, ``work`` does what they say."""
