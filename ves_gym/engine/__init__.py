"""From equations to numbers: MJCF, linear models, regressors, the compiled kernel, engines."""
