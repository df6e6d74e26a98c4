"""Judging recorded runs: one against its ground truth, many against gates and baselines."""
