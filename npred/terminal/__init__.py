"""What people see in a terminal: streams, messages, progress, logs, and event files."""
