"""The experiments of Tanner 2022 (arXiv 2206.13338), chapter 5, as sweeps."""
