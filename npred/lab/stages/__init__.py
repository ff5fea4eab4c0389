"""The stages: pure functions of a job; none of them knows the store. Each folder is one, and declares itself."""
