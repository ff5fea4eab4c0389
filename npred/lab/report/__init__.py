"""Every figure and table, once, and the terminal's views."""
