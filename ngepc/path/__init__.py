"""Path-following in gamma: Algorithm 7.2, its options, its state, its result."""
