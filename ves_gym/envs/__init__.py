"""Gymnasium environments. None is registered yet; see CHANGELOG.md."""
