"""What `eval/benchmark.py` consists of: jobs, the worker, checkouts, the report."""
