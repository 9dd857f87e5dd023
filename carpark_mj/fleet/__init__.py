"""The cars of an environment: presets drawn, randomized and checked."""
