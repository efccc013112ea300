"""The compiled kernel: one symbolic text of the physics, compiled to SIMD machine code.

`mechanics` writes forces and accelerations on symbols, `trace` makes graphs of them, `emit`
turns graphs into LLVM code that advances a block of simulations side by side, `build`
compiles and caches it. `maps` and `sensitivity` are for many configurations and for
derivatives; the engine is `engine/backends/kernel.py`.
"""
