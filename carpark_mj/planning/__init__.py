"""A classical planner: OMPL finds a path, a tracking controller drives it."""
