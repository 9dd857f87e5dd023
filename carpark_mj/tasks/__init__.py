"""Tasks beyond parking in a bay: reaching a pose, and episodes that a lot shares."""
