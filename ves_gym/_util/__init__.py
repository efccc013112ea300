"""Parameters with units, statistics, worker processes, MuJoCo's loading: knows no robot."""
