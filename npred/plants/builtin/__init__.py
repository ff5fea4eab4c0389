"""The built-in plants: one file each, or one for a family."""
