"""The trial: a generator of machines in which something is hidden, and what answers are worth.

It takes nothing from `ves_gym`: a machine comes as the plain table of a `system.toml`, logs
leave as CSV with metadata in JSON. What it computes with is its own: MuJoCo for the arm's
inertia and velocity terms (`arm.py`), frame elements for beams (`structure.py`), Runge-Kutta in
space (`space.py`), the laboratory's loop (`laboratory.py`), laws of what is hidden (`laws.py`).
`docs/diagnosis-trial.md` describes it.
"""
