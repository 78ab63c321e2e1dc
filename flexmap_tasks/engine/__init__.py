"""Stages, action keys, graphs and the runners that give them meaning."""
