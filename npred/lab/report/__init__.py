"""Every figure and table, once, and what a terminal shows."""
