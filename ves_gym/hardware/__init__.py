"""Parts of the emulator: admittance, force sensor, Stewart platform and its leg servos."""
