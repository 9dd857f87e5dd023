"""Units of length."""

WORLD_UNIT = 0.5625  # m; Tanner's car of 8 world units is then 4.5 m long
