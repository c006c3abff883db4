"""Studies: tables, figures and counts as objects that measure, keep what they have and write it."""
