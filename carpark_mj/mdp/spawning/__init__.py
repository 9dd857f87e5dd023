"""Where and how episodes begin."""
