"""The parts of the emulation loop as blocks with named signals, and the wires between them.

Each block is written once, as a pure function of arrays, and runs in NumPy, compiled, run
alone on measured signals, and differentiated.
"""
