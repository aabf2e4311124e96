"""Bags: write, read, salvage and compare them."""
