"""Why an estimate is bad: causes with their size, their evidence and what to do."""
