"""What is written to disk and read back: atomically, with its provenance."""
