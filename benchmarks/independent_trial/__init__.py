"""Logs of machines with hidden effects, made without the package that they judge.

Nothing here imports `ves_gym`: arm, beam, laboratory, friction and recorders are written anew
from the documentation. README.md says what they are and how they compare.
"""
