"""Measures speed: jobs, worker, checkouts, report."""
