"""Impulse responses and point-spread functions of images, measured."""
