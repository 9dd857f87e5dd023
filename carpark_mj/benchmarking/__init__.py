"""What the scripts that measure speed consist of: jobs, worker, checkouts, report."""
