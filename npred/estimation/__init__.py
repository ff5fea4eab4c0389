"""Estimates of the delay and the state, which are not measured."""
