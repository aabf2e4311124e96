"""Height images from airborne synthetic-aperture lidar and multi-beam radar: a core free of ROS, and ROS 2 nodes."""

__version__ = "0.1.0"
