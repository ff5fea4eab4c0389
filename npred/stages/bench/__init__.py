"""The stage bench: predictors timed beside their errors."""
