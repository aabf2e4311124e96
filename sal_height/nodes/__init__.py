"""ROS 2 nodes: parameters → core call → publish. No signal processing in here."""
