"""The compiled kernel: one symbolic text of the physics, compiled to SIMD machine code.

`mechanics` writes forces and accelerations on symbols, `trace` makes graphs of them, `emit`
turns graphs into LLVM code that works on a block of simulations side by side, `scalar` into a
GPU's; `build` compiles and keeps it. `compiled_function` has the one class in front of these.
`maps` and `sensitivity` are functions made with it; the engine is
`engine/backends/kernel.py`.
"""
