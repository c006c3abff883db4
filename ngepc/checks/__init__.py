"""Bad input is refused before any work: single arguments, whole problems, their supports."""
