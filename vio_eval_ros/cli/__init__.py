"""The verbs as command lines: shells around the evaluation, one file each."""
