"""Gymnasium environments: tasks, single and vector environment, registration."""

from ves_gym.envs.registration import register

register()
