"""Off-screen rendering; nothing is imported until it is used."""
