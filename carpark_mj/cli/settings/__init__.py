"""Settings of the commands, which import neither JAX nor MuJoCo: help is quick."""
