"""The generator of the blind benchmark: machines with one thing wrong, and their logs.

Independent of the simulator and of the selector that is judged with it: of `ves_gym` it
uses the parameter errors and the log format, and a machine's description as plain data.
`docs/diagnosis-benchmark.md` says what it models.
"""
