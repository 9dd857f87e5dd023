"""The learners, and what their training loops share."""
