"""Limits on states that are kept under delay: a filter of U, asked of the state that is predicted for when U acts."""

from npred.loop.safety.filter import SafetyFilter as SafetyFilter
