"""Studies: objects that measure, store and write tables, figures and counts."""
