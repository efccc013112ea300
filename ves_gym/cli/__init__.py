"""Command line: each module has a `TABLE` of its commands: what runs, and the options."""
