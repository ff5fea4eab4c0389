"""The plants that npred brings: one file each, or one for a family."""
