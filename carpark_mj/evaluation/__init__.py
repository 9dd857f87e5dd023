"""Evaluation of policies: roll-outs, metrics of many episodes, reports."""
