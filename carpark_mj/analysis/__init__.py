"""Several runs together: tables with intervals, plots, one page."""
