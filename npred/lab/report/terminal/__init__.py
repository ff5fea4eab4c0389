"""The terminal: streams, messages, progress, logs, and event files."""
