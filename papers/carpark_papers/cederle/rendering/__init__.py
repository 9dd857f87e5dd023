"""Pictures and videos of the junction."""
