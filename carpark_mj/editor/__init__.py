"""The layout editor: a page on which lots are drawn, and its server."""
