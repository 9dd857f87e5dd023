"""Which cars there are: presets drawn, randomized and checked."""
