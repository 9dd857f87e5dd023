"""Tables 6.1 to 6.4 of Cederle 2023."""
