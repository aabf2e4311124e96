"""Reflectivity over elevation in a pixel, as tomography of vegetation needs it, and the ground below it."""
