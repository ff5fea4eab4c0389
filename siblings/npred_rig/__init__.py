"""A rig: a plant and a controller, two processes with a network between them, on a real clock."""
