"""How episodes start: cars, goals and poses, for a whole lot or for some agents."""
