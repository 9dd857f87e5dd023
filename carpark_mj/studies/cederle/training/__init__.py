"""What all trainers of the junction share."""
