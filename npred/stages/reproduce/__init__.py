"""Published predictor-feedback experiments, run again: as published, and as their articles mean them."""
