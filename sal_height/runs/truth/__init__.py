"""Simulated flights, and their heights compared with the truth in numbers and pictures."""
