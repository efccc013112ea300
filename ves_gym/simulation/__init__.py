"""Simulator, playback of motions, the emulation loop, its stability and its calibration."""
