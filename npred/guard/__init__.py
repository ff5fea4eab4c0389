"""A network that is checked in every call."""
