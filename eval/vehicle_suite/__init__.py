"""What the scripts about the physics consist of: manoeuvres, formulas, tables."""
