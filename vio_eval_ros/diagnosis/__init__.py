"""Why an estimate is bad: faults with their size, their evidence and their cure."""
