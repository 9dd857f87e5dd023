"""The MuJoCo scene of a lot; nothing is imported until it is used."""
