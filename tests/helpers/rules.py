"""Parked rules that are limits alone, whatever the place and heading of the bay."""

from carpark_mj.config import PARKED_RULES

LIMITS = {name: rule for name, rule in PARKED_RULES.items() if rule.test is None}
