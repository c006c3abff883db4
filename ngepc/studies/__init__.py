"""Studies: the tables and figures of the paper, each a command whose results carry provenance."""
