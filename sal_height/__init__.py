"""Height images from airborne synthetic-aperture lidar and multi-beam radar: the core, free of ROS, and its ROS 2 nodes."""

__version__ = "0.1.0"
