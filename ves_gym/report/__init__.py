"""The report of a benchmark: a self-contained HTML page and static figures."""
