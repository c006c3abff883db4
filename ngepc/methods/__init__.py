"""The door to the methods: the exact one, the paper's, and which of them is meant."""
