"""Nodes with a sensor that does not wait: run, deployed, watched and recorded."""
