"""What a run leaves behind in a folder. Imports `simulation` and what stands below it."""
