"""Evaluation of a run, and its result."""
