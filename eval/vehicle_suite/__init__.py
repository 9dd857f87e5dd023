"""Manoeuvres, formulas and tables of `python eval/physics_report.py`."""
