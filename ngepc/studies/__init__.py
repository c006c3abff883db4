"""Studies: classes that run computations, store their records, and write tables and figures."""
