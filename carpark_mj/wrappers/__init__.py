"""Adapters to other libraries; each imports its target only in its own file."""
