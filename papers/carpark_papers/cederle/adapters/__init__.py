"""The junction in the interfaces of other libraries."""
