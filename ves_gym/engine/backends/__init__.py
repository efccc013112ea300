"""Engines that advance a batch of simulations of one System."""
