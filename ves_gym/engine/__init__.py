"""From equations to numbers: MJCF, linear models, the compiled kernel, engines."""
