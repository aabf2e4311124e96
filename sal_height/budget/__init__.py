"""The budget of a sensor: power, resolution, swath, pulses, data, accuracy, and what its errors do; without ROS."""
