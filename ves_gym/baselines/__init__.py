"""Baseline policies and training. None is shipped yet; see CHANGELOG.md."""
