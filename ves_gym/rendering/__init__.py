"""3-D drawing of a run, movies and windows."""
