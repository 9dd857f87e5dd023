"""The experiments of Tanner 2022, beside the published numbers."""
